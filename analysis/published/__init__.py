"""The numbers that published studies print, with where each stands."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from decimal import Decimal
from importlib import resources
from typing import Any


@dataclass(frozen=True)
class Printed:
    """A number as it is printed: its text tells value and precision.

    `unit` is one unit of the last printed digit. A bare "0" is a count of nothing, with no digit to round: unit 0.
    """

    text: str

    @property
    def value(self) -> float:
        """The number; a percentage as a ratio."""
        return float(self._decimal)

    @property
    def unit(self) -> float:
        """One unit of the last printed digit."""
        if self.text == "0":
            return 0.0
        exponent = self._decimal.as_tuple().exponent
        return float(Decimal(1).scaleb(int(exponent)))

    @property
    def _decimal(self) -> Decimal:
        if self.text.endswith("%"):
            return Decimal(self.text.removesuffix("%")).scaleb(-2)
        return Decimal(self.text)


@dataclass(frozen=True)
class PrintedCell:
    """A cell of a confusion matrix; `sd` is None where none is printed, `stars` where the place shows none."""

    where: str
    task: str
    presented: str
    answered: str
    mean: Printed
    sd: Printed | None
    stars: str | None


@dataclass(frozen=True)
class PrintedT:
    """A t-test against chance."""

    where: str
    task: str
    material: str
    df: int
    t: Printed
    p: Printed


@dataclass(frozen=True)
class PrintedF:
    """An F: `subject` is the effect's name, or the pair of materials."""

    where: str
    task: str | None
    subject: tuple[str, ...]
    df: tuple[int, int]
    f: Printed
    p: Printed


@dataclass(frozen=True)
class Published:
    """Everything that one study prints about answers."""

    study: str
    source: str
    chance: Printed
    cells: tuple[PrintedCell, ...]
    tests: tuple[PrintedT, ...]
    one_way: PrintedF
    two_way: PrintedF
    icc: Printed
    icc_where: str

    def tables(self) -> tuple[PrintedCell, ...]:
        """The cells that stand in tables, without those that the text repeats."""
        return tuple(cell for cell in self.cells if cell.stars is not None)

    def pairs(self) -> dict[str, tuple[str, str]]:
        """Task -> the two materials whose ratios the one-way ANOVA compares."""
        first, second = self.one_way.subject
        return {self.one_way.task: (first, second)} if self.one_way.task else {}


def load(study: str) -> Published | None:
    """The printed numbers of a study, by its id; None when none are held."""
    file = resources.files(__name__).joinpath(f"{study}.toml")
    if not study.isalnum() or not file.is_file():
        return None
    return _published(tomllib.loads(file.read_text(encoding="utf-8")))


def _published(content: dict[str, Any]) -> Published:
    cells = [
        PrintedCell(table["where"], table["task"], shown, said, Printed(mean), Printed(sd) if sd else None, stars)
        for table in content["table"]
        for shown, said, mean, sd, stars in table["cells"]
    ]
    cells += [
        PrintedCell(text["where"], text["task"], shown, said, Printed(mean), Printed(sd) if sd else None, None)
        for text in content["text"]
        for shown, said, mean, sd in text["cells"]
    ]
    tests = [
        PrintedT(group["where"], task, material, int(df), Printed(t), Printed(p))
        for group in content["t"]
        for task, material, df, t, p in group["tests"]
    ]
    one_way, two_way = content["one_way"], content["two_way"]
    return Published(
        study=content["study"],
        source=content["source"],
        chance=Printed(content["chance"]),
        cells=tuple(cells),
        tests=tuple(tests),
        one_way=_f(one_way, one_way["task"], tuple(one_way["pair"])),
        two_way=_f(two_way, None, (two_way["effect"],)),
        icc=Printed(content["icc"]["value"]),
        icc_where=content["icc"]["where"],
    )


def _f(content: dict[str, Any], task: str | None, subject: tuple[str, ...]) -> PrintedF:
    first, second = content["df"]
    return PrintedF(
        content["where"], task, subject, (int(first), int(second)), Printed(content["f"]), Printed(content["p"])
    )
