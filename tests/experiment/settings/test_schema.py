"""Schemas of settings files: what they say of each key."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.settings.load import Confined
from palpate.experiment.settings.schema import schema

MODELS = pytest.mark.parametrize("model", [ProtocolFile, Rig], ids=["protocol", "rig"])


def _tables(node: Any) -> Iterator[dict[str, Any]]:
    if isinstance(node, dict):
        if "properties" in node:
            yield node
        node = list(node.values())
    if isinstance(node, list):
        for one in node:
            yield from _tables(one)


@MODELS
def test_every_key_says_what_it_means_and_unknown_keys_are_refused(model: type[Confined]) -> None:
    tables = list(_tables(schema(model, "a file")))
    assert len(tables) > 10
    for table in tables:
        assert table["additionalProperties"] is False
        assert all(key.get("description") for key in table["properties"].values())


@MODELS
def test_it_has_the_keys_of_the_model_and_no_null_which_toml_lacks(model: type[Confined]) -> None:
    made = schema(model, "a file")
    assert list(made["properties"]) == list(model.model_fields)
    assert made["required"] == [name for name, field in model.model_fields.items() if field.is_required()]
    for key in (key for table in _tables(made) for key in table["properties"].values()):
        assert {"type": "null"} not in key.get("anyOf", [])
        assert key.get("default", 0) is not None


def test_allowed_values_stand_in_it() -> None:
    made = schema(ProtocolFile, "a file")
    assert made["$defs"]["Masker"]["properties"]["noise"]["enum"] == ["pink", "white"]
