"""Every key of a protocol file and of a rig file, for protocols/README.md: `python -m tests.keys` writes it there.

What a key means stands under `Attributes:` of its model, and what must hold between keys in the docstring of the
model's rules. Allowed values are told in the words of palpate's own error messages.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_origin

from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.protocol import designs, kinds
from palpate.experiment.protocol.designs import design_of
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.kinds import kind_of
from palpate.experiment.protocol.models import PlannedTest
from palpate.experiment.protocol.rules import pairs
from palpate.experiment.settings import load
from palpate.experiment.settings.load import Confined, none
from palpate.experiment.settings.schema import meanings, summary

README = Path(__file__).parent.parent / "protocols" / "README.md"
BEGIN, END = "<!-- keys: written by python -m tests.keys -->", "<!-- end of keys -->"

UNITS = {
    "_m_s2": "m/s²",
    "_mm_s": "mm/s",
    "_mm": "mm",
    "_px": "pixels",
    "mm": "mm",
    "_hz": "Hz",
    "_ms": "ms",
    "_min": "min",
    "_db_a": "dB(A)",
    "_db": "dB",
    "_days": "days",
    "_months": "months",
    "_v": "V",
    "_n": "N",
    "_n_m": "N/m",
    "_n_s_m": "N s/m",
    "_kg": "kg",
    "_s": "s",
    "gain_limit_v_per_m_s2": "V per m/s²",
    "baud": "bits/s",
}


def keys() -> str:
    """Return what stands between the markers of protocols/README.md, in Markdown."""
    files = (("A protocol file", ProtocolFile), ("A rig file", Rig))
    return "\n\n".join(f"## {title}\n\n" + "\n\n".join(_tables(model, model, ())) for title, model in files)


def written(readme: str) -> str:
    """Return the text of the README with its keys as the models have them."""
    before, _, rest = readme.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n\n{keys()}\n\n{END}{after}"


def _tables(root: type[Confined], model: type[Confined], path: tuple[str | int, ...]) -> Iterator[str]:
    """Yield one table of keys for a model, and one for each model that it holds."""
    said = meanings(model)
    rows = ["| key | meaning | unit | allowed | default |", "|:--|:--|:--|:--|:--|"]
    inner: list[str] = []
    for name, field in model.model_fields.items():
        inside, many = held(field.annotation)
        place = (*path, name)
        if inside is not None:
            inner += _tables(root, inside, (*place, 0) if many else place)
            allowed = f"the table {_header((*place, 0) if many else place)}"
            if many:
                least = next((part.min_length for part in field.metadata if hasattr(part, "min_length")), 0)
                allowed = f"{f'at least {least}' if least else 'any number'} of the tables {_header((*place, 0))}"
        else:
            allowed = load.field(root, place)
        default = "required" if field.is_required() else _default(field.default)
        rows.append(f"| `{name}` | {said[name]} | {_unit(name)} | {allowed} | {default} |".replace("  ", " "))
    heading = f"### {_header(path)}" if path else "### The top level"
    parts = [heading, summary(model), "\n".join(rows)]
    rules = [model.RULES] if model.RULES is not none else []
    if model is ProtocolFile:
        rules += [
            *(kind_of(name).rules for name in kinds.NAMES),
            *(design_of(name).rules for name in designs.NAMES),
            pairs,
        ]
    parts += [" ".join((rule.__doc__ or "").split()) for rule in rules]
    parts += ["\n".join(_planned_tests())] if model is PlannedTest else []
    yield "\n\n".join(parts)
    yield from inner


def _planned_tests() -> Iterator[str]:
    """Yield a table of the tests that designs offer, and of what each needs and may have."""
    yield "| test | design | needs | may have | since format |"
    yield "|:--|:--|:--|:--|--:|"
    for design in designs.NAMES:
        for name, test in design_of(design).tests.items():
            needs, takes = (", ".join(f"`{key}`" for key in keys) or "-" for keys in (test.needs, test.takes))
            yield f"| {name} | {design} | {needs} | {takes} | {test.since} |"


def held(annotation: Any) -> tuple[type[Confined] | None, bool]:
    """Return the model of a table or of an array of tables, and whether it is an array."""
    if isinstance(annotation, type) and issubclass(annotation, Confined):
        return annotation, False
    for argument in get_args(annotation):
        if isinstance(argument, type) and issubclass(argument, Confined):
            return argument, Ellipsis in get_args(annotation)
        if get_origin(argument) is tuple:
            return held(argument)
    return None, False


def _header(path: tuple[str | int, ...]) -> str:
    """Return how a table is opened in TOML, as code."""
    name = ".".join(part for part in path if isinstance(part, str))
    return f"`[[{name}]]`" if path[-1] == 0 else f"`[{name}]`"


def _default(value: object) -> str:
    """Return a default as it would stand in the file."""
    return f"`{json.dumps(value)}`" if value not in (None, ()) else "left out"


def _unit(key: str) -> str:
    return next((unit for ending, unit in sorted(UNITS.items(), key=lambda e: -len(e[0])) if key.endswith(ending)), "")


if __name__ == "__main__":
    README.write_text(written(README.read_text("utf-8")), "utf-8")
