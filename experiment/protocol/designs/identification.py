"""Identification in a protocol: a trial presents one material, which participants name."""

from collections.abc import Iterator

from palpate.experiment.protocol.designs import ProtocolDesign
from palpate.experiment.protocol.kinds import tables_at
from palpate.experiment.settings.load import Broken, Table


def _rules(table: Table) -> Iterator[Broken]:
    """In the design `identification` every material has `key` and `spoken`."""
    for i, one in tables_at(table, "materials"):
        if one.get("key") is None:
            yield Broken(("materials", i, "key"), "one ASCII character: participants name the material")
        if not one.get("spoken", ()):
            yield Broken(("materials", i, "spoken"), "an array of at least 1, each one line: participants name it")


DESIGN = ProtocolDesign(
    intervals=1,
    tests=("t against chance", "one-way ANOVA", "two-way ANOVA", "ICC", "equivalence"),
    rules=_rules,
    right=lambda _, presented, answered: answered == presented[0],
    shown=lambda protocol: tuple(material.spoken[0] for material in protocol.materials),
)
