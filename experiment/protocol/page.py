"""A protocol as one page of plain text, for an ethics board to read: every fact of the file, in sentences.

Lines of plain text: paragraphs, lists, facts and tables.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Sequence

from experiment.protocol import approval
from experiment.protocol.models import ExclusionRule, Material, PlannedTest, Protocol, Task

WIDTH = 92
"""Characters a line, at most."""

LEFT_EMPTY = "(left for the laboratory)"
"""How an empty field reads."""


def say(text: str, indent: str = "", first: str | None = None) -> list[str]:
    """A paragraph, wrapped; `first` stands before its first line instead of `indent`."""
    begin = indent if first is None else first
    return textwrap.wrap(" ".join(text.split()), WIDTH, initial_indent=begin, subsequent_indent=indent)


def item(text: str) -> list[str]:
    """One entry of a list."""
    return say(text, indent="    ", first="  - ")


def facts(*named: tuple[str, str]) -> Iterator[str]:
    """Names on the left, values on the right."""
    left = max(len(name) for name, _ in named) + 4
    for name, value in named:
        yield from say(value or LEFT_EMPTY, indent=" " * left, first=f"  {name}".ljust(left))


def table(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Columns under a heading row."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for place, row in enumerate(rows):
        yield "  " + "   ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        if place == 0:
            yield "  " + "   ".join("-" * width for width in widths)


def number(value: float) -> str:
    """A number without a needless `.0`."""
    return str(int(value)) if value == int(value) else str(value)


def quoted(words: Iterable[str]) -> str:
    """Words in quotes, with commas between."""
    return ", ".join(f'"{word}"' for word in words)


def count(things: int, noun: str) -> str:
    """How many things, in the plural where they are."""
    return f"{things} {noun}{'s' if things != 1 else ''}"


def page(protocol: Protocol) -> str:
    """The page, lines of at most 92 characters, ending in a newline."""
    sections: tuple[tuple[str, Iterable[str]], ...] = (
        ("Ethics approval", _ethics(protocol)),
        ("Participants and consent", _participants(protocol)),
        ("What is recorded", _recorded(protocol)),
        ("What a participant does", _procedure(protocol)),
        ("Tasks", _tasks(protocol)),
        ("Materials", _materials(protocol)),
        ("Stimuli", _stimuli(protocol)),
        ("Limits that protect the participant", _limits(protocol)),
        ("Answers", _answers(protocol)),
        ("Exclusion rules", _exclusion(protocol)),
        ("Planned analysis", _analysis(protocol)),
        ("Left for the laboratory", _left_empty(protocol)),
    )
    lines = [*say(protocol.study.title), "=" * WIDTH, *_title(protocol)]
    for place, (heading, body) in enumerate(sections, start=1):
        lines += ["", f"{place}. {heading}", "-" * WIDTH, *body]
    return "\n".join(lines) + "\n"


def _trials(protocol: Protocol, task: Task) -> int:
    return task.repetitions * len(protocol.materials)


def _title(protocol: Protocol) -> Iterator[str]:
    yield from facts(
        ("Study", protocol.study.id),
        ("Source", protocol.study.source),
        ("File format", str(protocol.format)),
        ("SHA-256", approval.sha256(protocol)),
    )
    yield from say(
        "The SHA-256 names this very protocol: it changes with any fact on this page, "
        "and an approval holds for it alone.",
        indent="  ",
    )


def _ethics(protocol: Protocol) -> Iterator[str]:
    ethics = protocol.ethics
    yield from facts(
        ("Board", ethics.board),
        ("Statement", ethics.statement),
        ("Approval number", ethics.approval_number),
        ("Approved on", str(ethics.approved_on or "")),
        ("Expires on", str(ethics.expires_on or "")),
        ("Contact", ethics.contact),
    )


def _participants(protocol: Protocol) -> Iterator[str]:
    yield from say(f"{count(protocol.study.participants, 'participant')}. Each meets every one of these criteria:")
    for criterion in protocol.eligibility.criteria:
        yield from item(criterion)
    yield ""
    if protocol.consent.required:
        yield from say(
            "Consent is required: no session starts before a participant's consent is on file. They consent to:"
        )
    else:
        yield from say("Consent is not required by this protocol. Participants are told:")
    yield from say(protocol.consent.statement, indent="    ")


def _recorded(protocol: Protocol) -> Iterator[str]:
    yield from say(
        "Under a number, never a name: the height of the foot over time, the speed and moment of each step, what was "
        "presented, the answer that the experimenter keyed and when, and every pause, repetition and its reason."
    )
    if protocol.consent.voice_recordings:
        yield from say("Spoken answers are recorded as sound, as participants consent to.")
    else:
        yield from say("No voice is recorded.")


def _procedure(protocol: Protocol) -> Iterator[str]:
    tasks = protocol.tasks
    pause_s = protocol.task_order.break_min_s
    shortest_s, longest_s = (
        sum(limits) + pause_s * (len(tasks) - 1)
        for limits in zip(*((task.familiarisation.min_s, task.familiarisation.max_s) for task in tasks), strict=True)
    )
    if protocol.task_order.kind == "fixed":
        yield from say("Participants with several tasks do them in the order given below (fixed order).")
    else:
        yield from say(
            "Participants with several tasks do them in counterbalanced order: every order is given to as many "
            "participants, by permuted blocks, so that they balance again and again while participants enrol."
        )
    if len({task.participants for task in tasks}) > 1:
        yield from say("Where a task has fewer participants than the study, those who enrol first do it.")
    yield from say(f"Break between tasks: at least {number(pause_s)} s ({_minutes(pause_s)}).")
    trials = sum(_trials(protocol, task) for task in tasks)
    yield from say(
        f"A participant who does every task has {trials} trials; familiarisation and breaks take "
        f"{_minutes(shortest_s)} to {_minutes(longest_s)}."
    )
    if protocol.duration is None:
        yield from say("Estimated duration of a visit: not stated.")
        return
    shortest_min, longest_min = protocol.duration.shortest_min, protocol.duration.longest_min
    each_s = max(longest_min * 60 - shortest_s, 0) / trials
    yield from say(
        f"Estimated duration of a whole visit, all tasks and breaks included: {number(shortest_min)} to "
        f"{number(longest_min)} min. That leaves up to {each_s:.0f} s a trial."
    )


def _minutes(seconds: float) -> str:
    return f"{number(round(seconds / 60, 1))} min"


def _tasks(protocol: Protocol) -> Iterator[str]:
    heading = ("task", "participants", "materials x repetitions = trials", "trials in the study")
    rows = [
        (
            task.id,
            str(task.participants),
            f"{len(protocol.materials)} x {task.repetitions} = {_trials(protocol, task)}",
            str(_trials(protocol, task) * task.participants),
        )
        for task in protocol.tasks
    ]
    yield from table([heading, *rows])
    for task in protocol.tasks:
        wanted = task.familiarisation
        yield ""
        yield from say(f"{task.id}: {task.title}")
        yield from facts(
            ("Stimuli", _STIMULUS[task.stimulus]),
            ("Before", f"{wanted.instruction} ({number(wanted.min_s)} to {number(wanted.max_s)} s)"),
            ("Instruction", task.instruction),
            ("Order", _order(task)),
        )


_STIMULUS = {
    "virtual": "virtual: vibration of the panel, synthesised from recordings",
    "real": "real: the experimenter lays out the real object before each step",
}


def _order(task: Task) -> str:
    match task.order.kind:
        case "full-random":
            return "full-random: every order of the trials is equally likely"
        case "blocked-random":
            return f"blocked-random: {count(task.repetitions, 'block')}, each with every material once, shuffled"
        case "max-run":
            return (
                f"max-run: every order in which no material comes more than {task.order.max_run} times in a row is "
                "equally likely"
            )


def _materials(protocol: Protocol) -> Iterator[str]:
    for material in protocol.materials:
        yield from item(_material(material))


def _material(material: Material) -> str:
    return f"{material.id}. {material.description} Said as {quoted(material.spoken)}; key [{material.key}]."


def _stimuli(protocol: Protocol) -> Iterator[str]:
    footstep, masker = protocol.footstep, protocol.masker
    synthesis, tactile, step = footstep.synthesis, footstep.tactile, footstep.step
    speeds = ", ".join(map(number, synthesis.speeds_mm_s))
    yield from say(
        f"Virtual stimuli are made from recordings of the real materials: {count(synthesis.takes, 'take')} at each of "
        f"the speeds {speeds} mm/s, each of {synthesis.samples} samples at {synthesis.rate_hz} Hz "
        f"({number(synthesis.samples / synthesis.rate_hz)} s). Takes are averaged by {synthesis.average}."
    )
    yield from say(
        f"Frequencies outside {number(tactile.low_hz)} to {number(tactile.high_hz)} Hz are left out of all stimuli of "
        f"a task where together they stay below {number(tactile.floor_m_s2)} m/s^2 (rms) in every material, and of "
        f"none otherwise. Source: {tactile.source}"
    )
    yield from say(
        f"The speed of the foot is measured while it falls from {number(step.gate_top_mm)} to "
        f"{number(step.gate_bottom_mm)} mm above the panel; the stimulus starts when it is at "
        f"{number(step.contact_mm)} mm. A foot that stops, turns back or hesitates on the way sets nothing off, and "
        "the trial is armed again at once."
    )
    yield from say(
        f"Headphones play {masker.noise} noise, whose level is set by the {masker.level_set_by}, until this holds: "
        f"{masker.criterion}"
    )


def _limits(protocol: Protocol) -> Iterator[str]:
    exposure, synthesis = protocol.exposure, protocol.footstep.synthesis
    yield from facts(
        ("Vibration", f"at most {number(exposure.vibration_peak_m_s2)} m/s^2 peak, whatever is asked of the device"),
        ("Masking noise", f"at most {number(exposure.masker_level_db_a)} dB(A)"),
        ("Session", f"at most {number(exposure.session_min)} min for one task"),
    )
    for task in protocol.tasks:
        if task.stimulus == "virtual":
            trials = _trials(protocol, task)
            total_s = number(round(trials * synthesis.samples / synthesis.rate_hz, 1))
            yield from say(f"Task {task.id} vibrates for {total_s} s in all, if no trial is repeated.", indent="  ")


def _answers(protocol: Protocol) -> Iterator[str]:
    answers = protocol.answers
    keys = "".join(f"[{material.key}] {material.id}, " for material in protocol.materials)
    yield from say(
        f"Mode: {answers.mode}. Participants answer aloud after each trial; the experimenter keys what they said:"
    )
    yield from say(
        f"{keys}[{answers.no_answer_key}] no answer, [{answers.redo_key}] do the trial again, "
        f"[{answers.pause_key}] pause.",
        indent="    ",
    )


def _exclusion(protocol: Protocol) -> Iterator[str]:
    if not protocol.exclusion:
        yield from say("None: every trial of every participant counts.")
    if any(rule.action == "repeat-trial" for rule in protocol.exclusion):
        yield from say(
            "A block is each material once where the order of a task is blocked-random, and the whole task where it "
            "is not."
        )
    for rule in protocol.exclusion:
        yield from item(f"{rule.id}: {_condition(rule)}, {_ACTION[rule.action]}: {rule.reason}")


_ACTION = {
    "repeat-trial": "the trial is repeated at the end of its block",
    "exclude-trial": "the trial is left out",
    "exclude-participant": "the participant is left out",
}


def _condition(rule: ExclusionRule) -> str:
    limit = "" if rule.limit is None else number(rule.limit)
    match rule.when:
        case "frames-lost":
            return f"if more than {limit} frames of the tracker are lost or damaged between arming and contact"
        case "speed-below":
            return f"if the foot comes at less than {limit} mm/s"
        case "speed-above":
            return f"if the foot comes at more than {limit} mm/s"
        case "undelivered":
            return "if the vibration was measured to come early, late, changed or not at all, by the rig's thresholds"
        case "answers-below":
            return f"if a participant answers fewer than {limit} trials of a task"
        case "withdrawn":
            return "if a participant withdraws"


def _analysis(protocol: Protocol) -> Iterator[str]:
    for planned in protocol.analysis:
        yield from item(_planned(planned))


def _planned(planned: PlannedTest) -> str:
    chance = "" if planned.chance is None else f" of {number(planned.chance)}"
    form = "" if planned.form is None else f" ({planned.form})"
    tasks = f"task{'s' if len(planned.tasks) > 1 else ''} {', '.join(planned.tasks)}"
    return f"{planned.test}{chance}{form}, {tasks}, alpha {number(planned.alpha)}. {planned.question}"


def _left_empty(protocol: Protocol) -> Iterator[str]:
    ethics = protocol.ethics
    empty = [name for name, value in ethics if value in ("", None)]
    if protocol.duration is None:
        empty.append("duration")
    if not empty:
        yield from say("Nothing: every field is filled in.")
    for name in empty:
        yield from item(name if name == "duration" else f"ethics.{name}")
