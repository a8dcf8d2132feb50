"""No format changes without its number."""

from __future__ import annotations

import json

import pytest

from palpate.experiment.protocol.models import Material
from tests import formats

HINT = "give each format that changed its next number, then run python -m tests.formats"


@pytest.fixture(scope="module")
def today() -> dict[str, formats.Description]:
    return formats.descriptions()


def test_every_format_is_the_one_that_was_described_under_its_number(today: dict[str, formats.Description]) -> None:
    described = {name: formats.FOLDER / f"{name}.json" for name in today}
    assert [name for name, path in described.items() if not path.exists()] == [], HINT
    changed = [name for name, path in described.items() if path.read_text("utf-8") != formats.text(today[name])]
    assert changed == [], HINT


def test_a_key_that_is_added_changes_the_description() -> None:
    class Later(Material):
        color: str | None = None

    one, other = (json.dumps(formats.schema(model)) for model in (Material, Later))
    assert '"color"' not in one
    assert '"color"' in other


def test_another_text_of_a_docstring_changes_none() -> None:
    class Reworded(Material):
        """Other words."""

    assert formats.schema(Reworded) == formats.schema(Material)
