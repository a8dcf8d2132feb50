"""protocols/keys.md lists every key as the models have it."""

from __future__ import annotations

import pytest

from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.protocol import rules
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.settings.load import Confined
from palpate.experiment.settings.schema import meanings
from tests import keys


def models(model: type[Confined]) -> list[type[Confined]]:
    inner = [keys.held(field.annotation)[0] for field in model.model_fields.values()]
    return [model, *(found for each in inner if each is not None for found in models(each))]


@pytest.mark.parametrize("model", [*models(ProtocolFile), *models(Rig)], ids=lambda model: model.__name__)
def test_every_key_has_a_meaning(model: type[Confined]) -> None:
    assert list(meanings(model)) == list(model.model_fields)


def test_the_file_lists_the_keys_of_the_models() -> None:
    assert keys.FILE.read_text("utf-8") == keys.keys(), "run python -m tests.keys"


def test_the_words_of_the_rules_name_their_limits() -> None:
    said = rules.protocol.__doc__ or ""
    assert f"no more than {rules.MAX_COUNTED} trials" in said
    assert f"At most {rules.MAX_COUNTERBALANCED} tasks" in said
