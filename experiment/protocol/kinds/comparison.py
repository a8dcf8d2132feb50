"""Comparisons of two materials in a protocol: their rules, and what a board's page says of them."""

from collections.abc import Iterator
from math import log

from palpate.experiment.protocol.blocks import Block, Item, Said, named, number
from palpate.experiment.protocol.kinds import ProtocolKind, number_at, table_at, tables_at
from palpate.experiment.protocol.models import Comparison, Protocol, Task, Virtual
from palpate.experiment.settings.load import Broken, Table

TESTS = ("Bradley-Terry", "Thurstone", "Davidson")
"""The planned tests."""

OF_STEPS = ("frames-lost", "speed-below", "speed-above", "undelivered")
"""What only a footstep has, for an exclusion rule to judge."""


def _rules(table: Table) -> Iterator[Broken]:
    """Yield what pairs cannot have."""
    for i, one in tables_at(table, "materials"):
        for key in ("key", "spoken"):
            if one.get(key):
                yield Broken(("materials", i, key), "no value: participants compare materials, and name none")
    for i, task in tables_at(table, "tasks"):
        if table_at(task, "order").get("kind") == "max-run":
            yield Broken(("tasks", i, "order", "kind"), "one of: full-random, blocked-random, with pairs of materials")
        if (count := number_at(task, "repetitions")) is not None and count % 2:
            yield Broken(("tasks", i, "repetitions"), "an even number: each pair is presented in both orders alike")
        if task.get("materials") is not None:
            yield Broken(("tasks", i, "materials"), "no value: a task of pairs presents every material")
    if table_at(table, "masker").get("probe") is not None:
        yield Broken(("masker", "probe"), "no table: real samples play no probe")
    if table_at(table, "answers").get("microphone") is True:
        yield Broken(("answers", "microphone"), "false: with pairs nobody names a material")
    for i, rule in tables_at(table, "exclusion"):
        if rule.get("when") in OF_STEPS:
            yield Broken(("exclusion", i, "when"), "one of: answers-below, withdrawn, with tasks of pairs")
    if any(task.get("stimulus") == "virtual" for _, task in tables_at(table, "tasks")):
        yield from _lacking(table)
    tied = table_at(table, "comparison").get("tie_key") is not None
    for i, test in tables_at(table, "analysis"):
        if test.get("test") in TESTS and (test["test"] == "Davidson") != tied:
            allowed = "Davidson: comparison.tie_key allows ties" if tied else "Bradley-Terry or Thurstone, without ties"
            yield Broken(("analysis", i, "test"), allowed)


def _lacking(table: Table) -> Iterator[Broken]:
    """Yield what virtual surfaces lack."""
    if table_at(table, "comparison").get("virtual") is None:
        yield Broken(("comparison", "virtual"), "a table: a task with virtual surfaces needs it")
    if table_at(table, "exposure").get("force_peak_n") is None:
        yield Broken(("exposure", "force_peak_n"), "a number of newtons: a task with virtual surfaces needs it")
    for i, one in tables_at(table, "materials"):
        for key in ("attack_hz", "amplitude"):
            if one.get(key) is None:
                yield Broken(("materials", i, key), "a number: a task with virtual surfaces renders every material")


def _keys(table: Table) -> list[tuple[tuple[str, ...], object]]:
    own = table_at(table, "comparison")
    return [
        *((("comparison", name), own.get(name)) for name in ("first_key", "second_key", "tie_key")),
        (("comparison", "virtual", "switch_key"), table_at(own, "virtual").get("switch_key")),
    ]


def _stimuli(protocol: Protocol) -> Iterator[Block]:
    if any(task.stimulus == "real" for task in protocol.tasks):
        yield Said(
            "Two real samples lie before the participant in each trial, who tries them as often as they wish, and "
            "changes from one to the other as often as they wish. No device moves or vibrates, and nobody tells the "
            "participant whether an answer was right."
        )
    if protocol.rendered is not None:
        yield from _rendered(protocol, protocol.rendered)


def _rendered(protocol: Protocol, virtual: Virtual) -> Iterator[Block]:
    mass = "is held" if virtual.mass_kg is None else f"has a mass of {number(virtual.mass_kg)} kg"
    yield Said(
        "In a task with virtual surfaces the hand moves a device, which pushes it back where a block begins. All "
        f"surfaces have one block: a spring of {number(virtual.stiffness_n_m)} N/m and a damper of "
        f"{number(virtual.damping_n_s_m)} N s/m, and it {mass}. The force is computed {virtual.rate_hz} times a second "
        f"and is never above {number(protocol.exposure.force_peak_n or 0.0)} N. It falls to zero, as does the "
        "vibration, where the device, the tracker or the program fails."
    )
    yield Said(
        "At the touch the finger is vibrated as a tap rings: a sinusoid that fades by exp(-t B), with B = "
        f"{number(virtual.decay_per_s)} /s, and grows with the speed of the tap. Its frequency, and its amplitude at "
        "200 mm/s:"
    )
    for one in protocol.materials:
        ring = round((one.amplitude or 0.0) * virtual.full_m_s2, 6)
        yield Item(f"{named(one.id)}: {number(one.attack_hz or 0.0)} Hz, {number(ring)} m/s^2.")
    yield Said(
        "The participant changes from one surface of a pair to the other as often as they wish: they say so, and the "
        f"experimenter presses [{virtual.switch_key}]. No answer is taken before both were tapped. A lamp says when "
        f"the hand is faster than {number(virtual.fastest_mm_s)} mm/s. Nobody tells the participant whether an answer "
        "was right."
    )


def _felt(protocol: Protocol, task: Task) -> str:
    if protocol.rendered is None:
        return ""
    faded_ms = 1e3 * log(1e3) / protocol.rendered.decay_per_s
    told = f"In task {task.id} the finger vibrates at every tap, and nothing limits taps but the time."
    return f"{told} Each time it has faded to a thousandth after {faded_ms:.0f} ms."


def _recorded(protocol: Protocol) -> str:
    if protocol.rendered is None:
        return ""
    return "the time and the speed of each tap on a virtual surface, each change from one to the other, "


def _asked(protocol: Protocol) -> str:
    comparison = protocol.comparisons
    tie = ", or neither" if comparison.tie_key is not None else "; they have to choose"
    return f"Participants say which of the two has more {named(comparison.quality)}{tie}."


KIND = ProtocolKind(
    table=Comparison,
    tests=TESTS,
    rules=_rules,
    keys=_keys,
    sources={
        "virtual": "virtual: surfaces that the rig renders",
        "real": "real: the experimenter lays out both samples before each trial",
    },
    recorded=_recorded,
    answers=lambda protocol: list(protocol.comparisons.answers.items()),
    stimuli=_stimuli,
    felt=_felt,
    pairs=(
        "A pair is two of the materials, or twice the same one. In half of the trials with a pair, drawn at random, "
        "the one of its materials is presented first, in the other half the other."
    ),
    asked=_asked,
    ranked=lambda protocol: f"From the least {named(protocol.comparisons.quality)} to the most:",
)
