"""Factors in a protocol: what its stimuli differ in, each value of one with each of the others.

A file with `[[factors]]` has one stimulus that names no material. Where the file is read, one stimulus and one material
for each combination take its place, so that the seal, the page, the draws and the analysis have them as any others.
"""

import string
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from math import prod
from typing import Annotated, Any, ClassVar

from pydantic import Field, ValidationError

from palpate.experiment.protocol.blocks import Block, Said, count, named, number
from palpate.experiment.protocol.blocks import facts as page_facts
from palpate.experiment.protocol.designs import NAMES, design_of
from palpate.experiment.protocol.kinds import list_at, table_at, tables_at
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.settings.load import ONE_LINE, Broken, Confined, Label, Name, Rules, Table
from palpate.experiment.storage import Place

MOST = 200
"""Combinations at most; ours: nobody compares or rates more."""

UNITS = {"_m_s2": "m/s^2", "_per_s": "/s", "_ms": "ms", "_hz": "Hz", "_s": "s"}
"""What a key ends in, and how a value of it is written."""

CHANGED = ("PresentedStimulus", "VirtualSurface", "Sinusoid", "Decaying", "Noise", "Sweep", "Pulses", "Silence")
"""Tables of stimuli, in which a key may be left to a factor."""

SITE = "site"
"""The key whose values are names: sites of the body."""

KEYS = string.digits[1:] + string.ascii_lowercase
"""Keys of combinations, where participants name them."""


def _factor_rules(table: Table) -> Iterator[Broken]:
    """`values` are all different, and there are as many `names`. With `changes = "site"` the `names` are the sites."""
    values, names = list_at(table, "values"), list_at(table, "names")
    if (table.get("changes") == SITE) == bool(values) or len(values or names) < 2:
        yield Broken(("values",), f"at least two values; none with changes = '{SITE}', which needs at least two names")
        return
    for i, one in enumerate(values):
        if one in values[:i]:
            yield Broken(("values", i), "a value that differs from all previous values")
    if names and values and len(names) != len(values):
        yield Broken(("names",), f"{len(values)} names, one per value")


class Factor(Confined):
    """How stimuli differ. Each combination of the values of all factors becomes a material, made from the one stimulus
    or surface that names no material. It is named after its values, such as `60 Hz at 2 m/s^2`. `[[materials]]` may add
    others, each with a stimulus.

    Attributes:
        id: its name in tables of results.
        changes: the key that it sets, which that stimulus omits: `delay_ms`, or a key of all waves of one type, such as
            `decaying.frequency_hz`; or `site`.
        values: its values.
        names: how materials' names show them, if not as number and unit; or the sites.
    """

    RULES: ClassVar[Rules] = _factor_rules

    id: Label
    changes: Annotated[
        str, Field(pattern=r"^[a-z_0-9]+(\.[a-z_0-9]+)?$", description="KEY or TABLE.KEY of the stimulus"), ONE_LINE
    ]
    values: tuple[Annotated[float, Field(ge=-100_000, le=100_000)], ...] = ()
    names: tuple[Name, ...] = ()

    @property
    def unit(self) -> str:
        """The unit of its values; empty for plain numbers."""
        return next((unit for end, unit in UNITS.items() if self.changes.endswith(end)), "")

    @property
    def levels(self) -> Sequence[float | str]:
        """What it sets its key to: numbers, or sites."""
        return self.values or self.names

    @property
    def written(self) -> tuple[str, ...]:
        """Each value with its unit, or each site."""
        return tuple(f"{number(one)} {self.unit}".rstrip() for one in self.values) or self.names

    @property
    def called(self) -> tuple[str, ...]:
        """What each value is called in the names of materials, which begin with no sign."""
        signed = zip(self.values, self.written, strict=True)
        return self.names or tuple(f"{self.id} {said}" if value < 0 else said for value, said in signed)


Factors = tuple[Factor, ...]
"""All of them, in the order of the file."""


def _materials(factors: Factors) -> dict[str, tuple[int, ...]]:
    """Return the name of each combination, the last factor fastest, with the places of its values."""
    every = product(*(range(len(one.levels)) for one in factors))
    return {" at ".join(of.called[i] for of, i in zip(factors, places, strict=True)): places for places in every}


def crossed(protocol: Protocol) -> dict[str, dict[str, float]]:
    """Return the numbers of each material that is made of factors, by their ids; nothing of a study without any."""
    factors: Factors = getattr(protocol, "factors", ())
    return {
        name: {of.id: of.values[i] for of, i in zip(factors, places, strict=True) if of.values}
        for name, places in (_materials(factors) if any(one.values for one in factors) else {}).items()
    }


def combinations(protocol: Protocol) -> frozenset[str]:
    """Return the materials that are made of the factors of a study that has some."""
    return frozenset(_materials(getattr(protocol, "factors", ())))


def _read(document: Table) -> Factors:
    """Return the factors of a plain document; none where one is not as it should be, of which its model tells."""
    try:
        return tuple(Factor.model_validate(one) for one in list_at(document, "factors"))
    except ValidationError:
        return ()


def _template(document: Table) -> tuple[str, str, int] | None:
    """Return the place of the one stimulus that names no material."""
    found = [
        (table, key, i)
        for table, own in document.items()
        if isinstance(own, Mapping)
        for key in own
        for i, one in tables_at(own, key)
        if key in ("stimuli", "surfaces") and one.get("material") is None
    ]
    return found[0] if len(found) == 1 else None


def _reasons(document: Table) -> Iterator[Broken]:
    """Yield why factors of a document as it was written cannot be crossed."""
    factors, place = _read(document), _template(document)
    if place is None:
        allowed = "one stimulus or virtual surface without a material, whose values the factors set"
        yield Broken(("factors",), allowed)
        return
    table, key, at = place
    if (crossings := prod(len(one.levels) for one in factors)) > MOST:
        yield Broken(("factors",), f"at most {MOST} combinations (there are {crossings})")
        return
    if len(_materials(factors)) < crossings:
        yield Broken(("factors",), "value names that make the name of each combination unique")
    for i, factor in enumerate(factors):
        places = list(_places(document[table][key][at], factor.changes.split(".")))
        if not places:
            yield Broken(("factors", i, "changes"), "a key of a table in the stimulus that has no material")
        for path, own in places:
            if own.get(str(path[-1])) is not None:
                allowed = f"no value: the factor '{factor.id}' sets it"
                yield Broken((*place, *path), allowed)


def _places(table: Table, path: Sequence[str]) -> Iterator[tuple[Place, Table]]:
    """Yield each place of a stimulus at which a factor sets its key, and the table in which that stands."""
    *within, key = path
    if not within:
        yield (key,), table
        return
    for name, held in table.items():
        several = held if isinstance(held, tuple) else (held,)
        for i, one in enumerate(several):
            at = (name, i) if isinstance(held, tuple) else (name,)
            if isinstance(one, Mapping):
                inner = _places(one, [key] if name == within[0] else path)
                yield from (((*at, *place), own) for place, own in inner)


def _put(held: Any, place: Place, value: float | str | None) -> Any:
    """Return a table, or tuple of tables, with a value at a place."""
    key, *rest = place
    if isinstance(held, tuple):
        return tuple(_put(one, tuple(rest), value) if i == key else one for i, one in enumerate(held))
    return {**held, key: _put(held[key], tuple(rest), value) if rest else value}


def renewed(document: Table) -> Table:
    """Return a document with a material and a stimulus of each combination; what cannot be crossed stays as it is."""
    factors, place = _read(document), _template(document)
    if not factors or place is None or any(_reasons(document)):
        return document
    table, key, at = place
    stimuli, made = document[table][key], []
    for name, places in _materials(factors).items():
        stimulus = {**stimuli[at], "material": name}
        for factor, i in zip(factors, places, strict=True):
            for where, _ in _places(stimuli[at], factor.changes.split(".")):
                stimulus = _put(stimulus, where, factor.levels[i])
        made.append(stimulus)
    crossing = ((name, _description(factors, places)) for name, places in _materials(factors).items())
    return {
        **document,
        "materials": (*list_at(document, "materials"), *_named(document, crossing)),
        table: {**document[table], key: (*stimuli[:at], *stimuli[at + 1 :], *made)},
    }


def _description(factors: Factors, places: Sequence[int]) -> str:
    return f"{', '.join(f'{of.id} {of.written[i]}' for of, i in zip(factors, places, strict=True))}."


def _named(document: Table, crossing: Iterator[tuple[str, str]]) -> Iterator[Table]:
    """Yield each material, with a key of its own and its name as what is said where participants name materials."""
    designs = [design for _, task in tables_at(document, "tasks") if (design := task.get("design")) in NAMES]
    taken = {one.get("key") for _, one in tables_at(document, "materials")}
    taken |= {value for name in document for key, value in table_at(document, name).items() if key.endswith("_key")}
    free = (one for one in KEYS if one not in taken)
    for name, description in crossing:
        told = {"key": next(free, None), "spoken": (name,)} if designs and design_of(designs[0]).table is None else {}
        yield {"id": name, **told, "description": description}


def stated(place: Place, document: Table) -> Place:
    """Return where a document states what stands at a place of the one that `renewed` returns."""
    if renewed(document) is document or (template := _template(document)) is None:
        return place
    table, key, at = template
    others = len(list_at(document[table], key)) - 1
    match place:
        case ("materials", int(i), *_) if i >= len(list_at(document, "materials")):
            return ("factors",)
        case (str(one), str(other), int(i), *rest) if (one, other) == (table, key):
            if i < others:
                return (table, key, i + (i >= at), *rest)
            names = [part for part in rest if isinstance(part, str)]
            for k, factor in enumerate(_read(document)):
                path = factor.changes.split(".")
                if names[-len(path) :] == path:
                    return ("factors", k)
            return (table, key, at, *rest)
    return place


def broken(table: Table) -> Iterator[Broken]:
    """Yield what is wrong with factors of a document that was renewed."""
    factors = _read(table)
    for i, one in enumerate(factors):
        if one.id in [other.id for other in factors[:i]]:
            yield Broken(("factors", i, "id"), "a unique name")
        if one.changes in [other.changes for other in factors[:i]]:
            yield Broken(("factors", i, "changes"), "a key that no other factor sets")
    ids = {one.get("id") for _, one in tables_at(table, "materials")}
    if factors and not ids.issuperset(_materials(factors)):
        yield from _reasons(table)
    elif factors:
        yield from _unlike(table, factors)


def _unlike(document: Table, factors: Factors) -> Iterator[Broken]:
    """Yield where a stimulus of a combination has not its values, or differs from the others in more than these."""
    made, alike = _materials(factors), None
    for table, own in document.items():
        for key in ("stimuli", "surfaces"):
            for i, one in tables_at(own, key) if isinstance(own, Mapping) else ():
                if (places := made.get(str(one.get("material")))) is None:
                    continue
                rest = {**one, "material": None}
                for factor, at in zip(factors, places, strict=True):
                    for where, held in _places(one, factor.changes.split(".")):
                        if held.get(str(where[-1])) != factor.levels[at]:
                            yield Broken((table, key, i, *where), f"{factor.written[at]}, by the factor '{factor.id}'")
                        rest = _put(rest, where, None)
                alike = alike or rest
                if rest != alike:
                    yield Broken(
                        (table, key, i), "the value in the first combination, except for keys that the factors set"
                    )


def relaxed(schema: Mapping[str, Any]) -> dict[str, Any]:
    """Return the JSON Schema of a protocol file in which nothing lacks that a file with factors leaves out."""
    tables = {name: one | ({"required": []} if name in CHANGED else {}) for name, one in schema["$defs"].items()}
    return {**schema, "$defs": tables, "required": [one for one in schema["required"] if one != "materials"]}


def blocks(protocol: Protocol) -> Iterator[Block]:
    """Yield what the board reads of the factors of a study that has some."""
    factors: Factors = getattr(protocol, "factors", ())
    whole = all(task.materials is None and task.levels is None for task in protocol.tasks)
    often = " In each task, all values of a factor are presented equally often." if whole else ""
    of = "each value of the factor" if len(factors) == 1 else "every combination of the factors' values"
    yield Said(
        f"{count(prod(len(one.levels) for one in factors), 'material')} vary by factors ({of}) and are otherwise "
        f"identical.{often} The factors set:"
    )
    yield page_facts(*((one.id, f"{one.changes}: {_values(one)}") for one in factors))


def _values(factor: Factor) -> str:
    if not (factor.names and factor.values):
        return ", ".join(factor.written)
    named_values = zip(factor.written, factor.names, strict=True)
    return ", ".join(f"{said} ({named(name)})" for said, name in named_values)
