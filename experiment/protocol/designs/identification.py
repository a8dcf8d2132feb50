"""Identification in a protocol: a trial presents one material, which participants name."""

from collections.abc import Iterator, Sequence

from palpate.experiment.protocol.designs import SEVERAL, TWO, Meaning, PlannableTest, ProtocolDesign
from palpate.experiment.protocol.kinds import table_at, tables_at
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.settings.load import Broken, Table

CHOSEN, HOLM = {"materials": 6}, {"correction": 6}

TESTS = {
    "t against chance": PlannableTest(needs=("chance",), takes={"correction": 2}),
    "one-way ANOVA": PlannableTest(takes={"materials": 3}, materials=TWO, each=2),
    "two-way ANOVA": PlannableTest(tasks=SEVERAL, common=(2, 2)),
    "ICC": PlannableTest(needs=("form",), common=(2, 2)),
    "equivalence": PlannableTest(needs=("margin",), takes=CHOSEN, common=(2, 1)),
    "sign flips against chance": PlannableTest(needs=("chance",), takes=CHOSEN | HOLM, since=6),
    "sign flips between tasks": PlannableTest(takes=CHOSEN | HOLM, tasks=SEVERAL, common=(1, 1), since=6),
    "sign flips between materials": PlannableTest(takes=CHOSEN | HOLM, each=2, common=(2, 0), since=6),
    "repeated measures": PlannableTest(takes=CHOSEN, common=(2, 2), since=6),
    "logit with participants": PlannableTest(common=(1, 1), since=6),
    "order of tasks": PlannableTest(takes=CHOSEN, tasks=TWO, common=(1, 1), since=6),
    "difference of groups": PlannableTest(needs=("groups",), takes=CHOSEN | HOLM, common=(1, 1), since=7),
}
"""The published tests, then equivalence and those in which participants are the unit, which hold."""


def _rules(table: Table) -> Iterator[Broken]:
    """In the design `identification`, every material has `key` and `spoken`, and the test `order of tasks` needs a
    `counterbalanced` order. Only `sign flips between tasks` and `difference of groups` have the `correction` `tasks`.
    Groups are the values of a `choice` in `[[asked.people]]` or, with `group`, those of `[[groups]]`.
    """
    known = {one.get("id"): one.get("answer") for _, one in tables_at(table_at(table, "asked"), "people")}
    chosen = [name for name, answer in known.items() if answer == "choice"] + ["group"] * bool(table.get("groups"))
    for i, one in tables_at(table, "materials"):
        if one.get("key") is None:
            yield Broken(("materials", i, "key"), "one ASCII character, because participants name the material")
        if not one.get("spoken", ()):
            yield Broken(
                ("materials", i, "spoken"),
                "an array of at least 1, each a single line, because participants name the material",
            )
    for i, test in tables_at(table, "analysis"):
        paired, family = (
            test.get("test") in ("sign flips between tasks", "difference of groups"),
            test.get("correction"),
        )
        if (groups := test.get("groups")) is not None and groups not in chosen:
            own = ", ".join(map(str, chosen)) or "none"
            allowed = f"the id of a choice in [[asked.people]], or 'group' for [[groups]], one of: {own}"
            yield Broken(("analysis", i, "groups"), allowed)
        if family is not None and paired != (family == "tasks"):
            yield Broken(("analysis", i, "correction"), "tasks" if paired else "one of: materials, materials and tasks")
        if test.get("test") == "order of tasks" and table_at(table, "task_order").get("kind") == "fixed":
            yield Broken(
                ("task_order", "kind"), "counterbalanced: in a fixed order, everyone does the tasks in the same order"
            )


def _answers(protocol: Protocol, _: Sequence[str]) -> dict[str, Meaning]:
    # The rules give every material its key.
    return {one.key or "": Meaning(one.id, _spoken(one.id, one.spoken[0])) for one in protocol.materials}


def _spoken(material: str, said: str) -> str:
    return material if said == material else f"{material} ('{said}')"


DESIGN = ProtocolDesign(
    since=0,
    intervals=(1,),
    tests=TESTS,
    rules=_rules,
    answers=_answers,
    presents=lambda protocol, task: f"{(n := len(protocol.materials_of(task)))} material{'' if n == 1 else 's'}",
    right=lambda _, presented, answered: answered == presented[0],
    shown=lambda protocol: tuple(material.spoken[0] for material in protocol.materials),
)
