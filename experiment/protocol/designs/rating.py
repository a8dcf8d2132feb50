"""Rating in a protocol: a trial presents one material, and participants say how much of a quality it has."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Annotated

from pydantic import Field

from palpate.experiment.protocol.designs import Meaning, PlannableTest, ProtocolDesign
from palpate.experiment.protocol.kinds import number_at, table_at, tables_at
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.settings.load import Broken, Confined, Key, Name, Table
from palpate.experiment.storage import Place

TESTS = {
    "mean ratings": PlannableTest(common=(2, 2), since=7),
    "agreement of ratings": PlannableTest(common=(2, 2), since=7),
    "power law": PlannableTest(common=(2, 2), since=7),
}
"""The planned tests: repeated measures of materials, intraclass correlations, and magnitude functions."""


class Point(Confined):
    """A step of the rating scale.

    Attributes:
        key: experimenter's key for this value.
        value: its number, greater than the previous one.
        label: its name; if omitted, only its number is shown.
    """

    key: Key
    value: float
    label: Name | None = None

    @property
    def answer(self) -> str:
        """What goes on record."""
        return f"{self.value:.12g}"


class Magnitude(Confined):
    """A material's physical magnitude.

    Attributes:
        material: which one.
        value: magnitude, in `rating.unit`.
    """

    material: Name
    value: Annotated[float, Field(gt=0)]


class Rating(Confined):
    """Settings for trials of the design `rating`: participants rate a material on a scale.

    Attributes:
        quality: what is rated, such as roughness.
        scale: the places, from the least of it to the most.
        standard: the material whose rating participants are told; if omitted, there is none.
        modulus: that rating.
        unit: unit of the physical `magnitudes`, such as m/s^2.
        magnitudes: how much each material has of what its rating may be a power of; a `power law` needs it.
    """

    quality: Name
    scale: Annotated[tuple[Point, ...], Field(min_length=2)]
    standard: Name | None = None
    modulus: float | None = None
    unit: Name | None = None
    magnitudes: tuple[Magnitude, ...] = ()


def _rules(table: Table) -> Iterator[Broken]:
    """The design `rating` needs `[rating]`; the values of its `scale` increase, and no material has `key` or `spoken`.

    `standard` is a material and has a `modulus`, one of the values. `magnitudes` are given for each material and have a
    `unit`; `power law` needs magnitudes, and values above 0. `answers.microphone` is false.
    """
    if table.get("rating") is None:
        yield Broken(("rating",), "a table, because tasks with the design 'rating' need it")
    own = table_at(table, "rating")
    for i, one in tables_at(table, "materials"):
        for key in ("key", "spoken"):
            if one.get(key):
                yield Broken(("materials", i, key), "no value: participants rate materials but do not name them")
    if table_at(table, "answers").get("microphone") is True:
        yield Broken(("answers", "microphone"), "false: participants do not name materials in rating tasks")
    values = [number_at(place, "value") for _, place in tables_at(own, "scale")]
    for i, (below, above) in enumerate(pairwise(values), start=1):
        if below is not None and above is not None and above <= below:
            yield Broken(("rating", "scale", i, "value"), f"a number greater than the previous one ({below})")
    yield from _standard(own, values, ids := [one.get("id") for _, one in tables_at(table, "materials")])
    yield from _magnitudes(table, own, values, ids)


def _standard(own: Table, values: list[float | None], ids: list[object]) -> Iterator[Broken]:
    standard, modulus = own.get("standard"), own.get("modulus")
    if standard is not None and standard not in ids:
        yield Broken(("rating", "standard"), f"one of the materials: {', '.join(map(str, ids))}")
    if (standard is None) != (modulus is None):
        yield Broken(("rating", "modulus"), "a value if there is a standard, otherwise no value")
    if modulus is not None and modulus not in values:
        yield Broken(("rating", "modulus"), f"a value on the scale: {', '.join(map(str, values))}")


def _magnitudes(table: Table, own: Table, values: list[float | None], ids: list[object]) -> Iterator[Broken]:
    of = [one.get("material") for _, one in tables_at(own, "magnitudes")]
    if of and (sorted(map(str, of)) != sorted(map(str, ids)) or own.get("unit") is None):
        yield Broken(("rating", "magnitudes"), "one magnitude for each material, and a unit")
    for i, test in tables_at(table, "analysis"):
        if test.get("test") == "power law" and (
            not of or any(not isinstance(one, int | float) or one <= 0 for one in values)
        ):
            allowed = "a different test: 'power law' needs rating.magnitudes and a scale whose values are all above 0"
            yield Broken(("analysis", i, "test"), allowed)


def _keys(table: Table) -> list[tuple[Place, object]]:
    scale = tables_at(table_at(table, "rating"), "scale")
    return [(("rating", "scale", i, "key"), one.get("key")) for i, one in scale]


def words(place: Point) -> str:
    """Return a place in words: its number, and what it is called."""
    return place.answer if place.label is None else f"{place.answer} ({place.label})"


def _answers(protocol: Protocol, _: Sequence[str]) -> dict[str, Meaning]:
    return {place.key: Meaning(place.answer, words(place)) for place in protocol.table(Rating).scale}


def _presents(protocol: Protocol, task: Task) -> str:
    return f"{len(protocol.materials_of(task))} materials, rated for their {protocol.table(Rating).quality}"


DESIGN = ProtocolDesign(
    table=Rating,
    since=7,
    intervals=(1,),
    tests=TESTS,
    rules=_rules,
    keys=_keys,
    answers=_answers,
    named=lambda protocol: {place.answer: words(place) for place in protocol.table(Rating).scale},
    presents=_presents,
    asks=lambda protocol: f"How much {protocol.table(Rating).quality} did you feel?",
    shown=lambda protocol: tuple(map(words, protocol.table(Rating).scale)),
)
