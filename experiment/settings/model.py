"""The base of every model of a settings file, and what its rules say.

A rule holds between fields, beyond the type of each. It reads a plain table (arrays as tuples), and passes over what
is missing or of the wrong type, so that a file with one wrong type still has all its rules checked and every problem
is reported at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

Table = Mapping[str, Any]
Path = tuple[str | int, ...]

BROKEN_RULE = "broken_rule"
"""Type of the validation error that stands for broken rules."""

Text = Annotated[str, Field(pattern=r"\S", description="text, not blank")]
Label = Annotated[
    str,
    Field(
        pattern=r"^[a-z][a-z0-9]{0,31}$",
        description="up to 32 lower-case letters and digits, a letter first (it names files)",
    ),
]
Name = Annotated[
    str,
    Field(
        pattern=r"^[^\s\p{Cc}]([^\p{Cc}]{0,38}[^\s\p{Cc}])?$",
        description="one line of 1 to 40 characters, no blank at either end",
    ),
]
Key = Annotated[
    str,
    Field(pattern=r"^[!-@\[-~]$", description="one ASCII character, neither a capital letter nor a blank"),
]


@dataclass(frozen=True)
class Broken:
    """One rule that does not hold: the field to mend, from the table that was checked, and what it may be."""

    path: Path
    allowed: str


Rules = Callable[[Table], Iterable[Broken]]


def none(_table: Table) -> Iterable[Broken]:
    """No rule."""
    return ()


def written(path: Path) -> str:
    """Return a path as users read it: `tasks[0].order.kind`."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            bare = part.isascii() and part.replace("_", "a").replace("-", "a").isalnum()
            text += ("." if text else "") + (part if bare else f'"{part}"')
    return text


class Confined(BaseModel):
    """Base of every model: frozen, strict, no unknown key."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)

    RULES: ClassVar[Rules] = none

    @model_validator(mode="after")
    def _rules_hold(self) -> Self:
        broken = tuple(type(self).RULES(self.model_dump()))
        if broken:
            text = "; ".join(f"{written(one.path)}: allowed: {one.allowed}" for one in broken)
            raise PydanticCustomError(BROKEN_RULE, "{text}", {"text": text})
        return self
