"""JSON Schemas of settings files, by which an editor completes keys, shows what they mean, and marks errors.

A schema has types, bounds and allowed values, and what each key means. Rules between keys are `palpate check`'s alone.
"""

import inspect
import re
from typing import Any

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from palpate.experiment.settings.load import Confined

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def meanings(model: type[Confined]) -> dict[str, str]:
    """Return what a model's docstring says of each key under `Attributes:`."""
    _, _, listed = inspect.cleandoc(model.__doc__ or "").partition("Attributes:\n")
    entries = re.findall(r"^    (\w+): (.+(?:\n {8}.+)*)", listed, re.MULTILINE)
    return {name: " ".join(text.split()).rstrip(".") for name, text in entries}


def summary(model: type[Confined]) -> str:
    """Return what a model's docstring says of it as a whole."""
    before, _, _ = inspect.cleandoc(model.__doc__ or "").partition("\n\nAttributes:")
    return " ".join(before.split())


def schema(model: type[Confined], title: str) -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a file of this model."""
    made = model.model_json_schema(schema_generator=_Described)
    return {"$schema": DIALECT, "$comment": "made by palpate", **made, "title": title}


class _Described(GenerateJsonSchema):
    """Says of each key what its model's docstring says of it; TOML has no null."""

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        made, model = super().model_schema(schema), schema["cls"]
        made["description"] = summary(model)
        made.pop("title", None)
        meant = meanings(model)
        for name, value in made.get("properties", {}).items():
            allowed = value.pop("description", "")
            value["description"] = ". ".join(
                part for part in (meant.get(name, ""), f"Allowed: {allowed}" if allowed else "") if part
            )
            value.pop("title", None)
        return made

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        made = super().default_schema(schema)
        if made.get("default", ...) is None:
            del made["default"]
        return made
