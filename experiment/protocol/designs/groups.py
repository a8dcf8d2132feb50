"""Groups in a protocol: participants are drawn into them as they enrol, and the experimenter does otherwise with each.

A file with `[[groups]]` has two or more. The roster's line of a participant has their group, and so has the column
`group` of participants.tsv, by which a planned difference of groups may compare them.
"""

from collections.abc import Iterator

from palpate.experiment.errors import Finding, mismatch
from palpate.experiment.protocol.blocks import Block, Item, Quoted, Said, named
from palpate.experiment.protocol.kinds import table_at, tables_at
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.settings.characters import looks
from palpate.experiment.settings.load import MISSING, Broken, Confined, Name, Table, Text

COLUMN = "group"
"""The column of participants.tsv, and what a planned test calls these groups."""


class Group(Confined):
    """Groups to which participants are randomly assigned as they enroll.

    Attributes:
        id: its name.
        description: what differs, shown at the console.
    """

    id: Name
    description: Text


Groups = tuple[Group, ...]
"""All of them, in the order of the file."""


def groups(protocol: Protocol) -> Groups:
    """Return the groups of a protocol; nothing of a study without any."""
    found: Groups = getattr(protocol, "groups", ())
    return found


def broken(table: Table) -> Iterator[Broken]:
    """Yield a single group, names that look alike or are read as missing, and a fact with the column of groups."""
    known: set[str] = set()
    own = tables_at(table, "groups")
    if len(own) == 1:
        yield Broken(("groups",), "at least two groups, or none at all")
    for i, one in own:
        name = str(one.get("id"))
        if name in MISSING or not known.isdisjoint(looks(name)):
            yield Broken(("groups", i, "id"), "a unique name that does not mean a missing value, such as NA")
        known |= {*looks(name)}
    for i, fact in tables_at(table_at(table, "asked"), "people"):
        if fact.get("id") == COLUMN:
            yield Broken(
                ("asked", "people", i, "id"), f"a name other than {COLUMN}, which is the column for [[groups]]"
            )


def blocks(protocol: Protocol) -> Iterator[Block]:
    """Yield what a board reads of the groups."""
    yield Said(
        "Participants are assigned to groups at random as they enroll. Permuted blocks, each with one participant "
        "from each group, balance the groups, and the task orders within each group. The experimenter knows which "
        "group a participant is in. Differences between the groups:"
    )
    for one in groups(protocol):
        yield Item(f"{named(one.id)}:")
        yield Quoted(one.description)


def advice(protocol: Protocol) -> Iterator[Finding]:
    """Yield a number of participants that cannot be divided equally among the groups."""
    people, count = protocol.study.participants, len(groups(protocol))
    if count and people % count:
        allowed = f"usually a multiple of {count}, so that the groups are of equal size"
        yield mismatch("study.participants", None, str(people), allowed)


def column(protocol: Protocol) -> dict[str, object]:
    """Return what the sidecar of participants.tsv says of the column."""
    levels = {one.id: one.description for one in groups(protocol)}
    return {"Description": "Group to which the participant was randomly assigned at enrollment.", "Levels": levels}
