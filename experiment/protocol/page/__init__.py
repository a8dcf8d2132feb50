"""The page that states every fact of a protocol to an ethics board, as plain text and as HTML, and odd values of it."""

from collections.abc import Iterable, Iterator
from datetime import date
from importlib import import_module
from itertools import pairwise
from math import ceil, comb, factorial
from pathlib import Path
from typing import Any

from palpate.experiment.errors import Finding, mismatch
from palpate.experiment.protocol import approval
from palpate.experiment.protocol.approval import Seal, sealing
from palpate.experiment.protocol.blocks import (
    Block,
    Facts,
    Free,
    Gap,
    Item,
    Quoted,
    Rows,
    Said,
    count,
    facts,
    named,
    number,
)
from palpate.experiment.protocol.designs import design_of
from palpate.experiment.protocol.models import PlannedTest, Protocol, Task
from palpate.experiment.protocol.page import rendering
from palpate.experiment.protocol.page.words import design_words, kind_words
from palpate.experiment.settings.load import written

IN_SEAL = "(in the seal, once the board has approved)"
"""How an empty field reads that the seal holds and the file leaves out."""

NOTHING_RUNS = "default-src 'none'; style-src 'unsafe-inline'"
"""What a browser is told of the file, should an escape ever fail: nothing is fetched, and no script runs."""

ROUNDED = 0.025
"""A chance this near to that of a guess is one that was rounded, of itself: 0.17 for 1/6, 0.33 for 1/3."""

LEAST_S = 5.0
"""A trial takes a step, a stimulus and an answer that is keyed twice: less time than this is no plan; ours."""

STOPS = (
    "Only software enforces these limits, and software is not a safety function. In hardware, the laboratory limits "
    "the output of its amplifier, and an emergency stop cuts the power. For a force device, or an actuator that can "
    "exceed the vibration limit, palpate runs no session unless the rig file describes both safeguards and gives the "
    "day on which they were tested. The participant can stop everything within 0.2 s with a pedal or a key at the "
    "screen. On a rig with neither, the participant can only ask to stop."
)
"""What the board reads below the limits of a protocol that renders something."""


def page(protocol: Protocol, file: str) -> str:
    """Return the page of the protocol in `file`, in lines of at most 92 columns, ending in a newline."""
    made = [heading(protocol), "=" * rendering.WIDTH, *rendering.lines(title(protocol, file))]
    for place, (name, section) in enumerate(sections(protocol), start=1):
        made += ["", f"{place}. {name}", "-" * rendering.WIDTH, *rendering.lines(section)]
    return "\n".join(made) + "\n"


def approved(seal: Seal) -> str:
    """Return what a seal says, in lines as those of the page."""
    return "\n".join(rendering.lines([approval_of(seal)]))


def html(protocol: Protocol, file: str, state: str, seal: Seal | None, today: date, rig: Iterable[Block] = ()) -> str:
    """Return the page as one file of HTML for a browser and for A4, in which nothing runs or is fetched.

    `state` and `seal` are those of `approval.sealing.state`; `rig` stands last. The foot of every printed sheet names
    the version and whether it is approved.
    """
    word = state.partition(":")[0]
    until = f" until {seal.expires_on}" if seal is not None and word == "SEALED" else ""
    known: list[Block] = [Said(f"{state} (Status on {today}.)"), *([approval_of(seal)] if seal else [])]
    parts = [
        f"<h1>{rendering.html_text(heading(protocol))}</h1>",
        f'<div class="state">{rendering.html_blocks(known)}</div>',
    ]
    parts.append(rendering.html_blocks(title(protocol, file)))
    parts += [
        f"<section><h2>{place}. {rendering.html_text(name)}</h2>{rendering.html_blocks(section)}</section>"
        for place, (name, section) in enumerate(sections(protocol), start=1)
    ]
    if rig := tuple(rig):
        parts.append(
            "<section><h2>About the rig (not part of the protocol or its "
            f"seal)</h2>{rendering.html_blocks(rig)}</section>"
        )
    foot = f"Study {protocol.study.id}, {word}{until}. SHA-256 of the protocol:"
    style = Path(__file__).with_name("page.css").read_text("utf-8")
    return (
        '<!DOCTYPE html>\n<html lang="en" dir="ltr"><head><meta charset="utf-8">'
        '<meta name="generator" content="palpate">'
        f'<meta http-equiv="Content-Security-Policy" content="{NOTHING_RUNS}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{rendering.html_text(heading(protocol))}</title><style>\n{style}</style></head>\n"
        '<body><table class="sheet" role="presentation">'
        f'<tfoot><tr><td><p>{rendering.html_text(foot)} <span class="hash">{approval.sha256(protocol)}</span></p></td>'
        "</tr></tfoot>\n"
        f"<tbody><tr><td><main>{''.join(parts)}</main></td></tr></tbody></table></body></html>\n"
    )


def heading(protocol: Protocol) -> str:
    """Return what stands above the page."""
    return f"Protocol of the study {protocol.study.id}"


def sections(protocol: Protocol) -> tuple[tuple[str, Iterator[Block]], ...]:
    """Return the sections of the page, each with its name."""
    return (
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
        ("Worth a second look", _odd(protocol)),
    )


def approval_of(seal: Seal) -> Facts:
    """Return what a seal says."""
    return facts(
        ("Board", Free(seal.board)),
        ("Approval number", Free(seal.approval_number)),
        ("Approved on", str(seal.approved_on)),
        ("Expires on", str(seal.expires_on)),
    )


def title(protocol: Protocol, file: str) -> Iterator[Block]:
    """Yield what stands before the first section."""
    yield facts(
        ("Title", Free(protocol.study.title)),
        ("Source", Free(protocol.study.source)),
        ("File", Free(file)),
        ("File format", str(protocol.format)),
        ("SHA-256", approval.sha256(protocol)),
    )
    yield Said(
        "The SHA-256 identifies this version of the protocol. It changes whenever a fact on this page changes, except "
        "the name of the file. An approval covers this version only.",
        indent="  ",
    )
    yield Said(
        "Text behind a bar or in double quotes is quoted word for word from the file. palpate writes everything else "
        "on this page from the values in the file. These values apply, whatever a quoted text may say.",
        indent="  ",
    )


def _ethics(protocol: Protocol) -> Iterator[Block]:
    ethics = protocol.ethics
    yield facts(
        ("Board", Free(ethics.board)),
        ("Statement", Free(ethics.statement)),
        ("Approval number", Free(ethics.approval_number) if ethics.approval_number else IN_SEAL),
        ("Approved on", str(ethics.approved_on or IN_SEAL)),
        ("Expires on", str(ethics.expires_on or IN_SEAL)),
        ("Contact", Free(ethics.contact)),
    )


def _participants(protocol: Protocol) -> Iterator[Block]:
    yield Said(
        f"The study has {count(protocol.study.participants, 'participant')}. Everyone who takes part must meet all of "
        "these criteria:"
    )
    for criterion in protocol.eligibility.criteria:
        yield Quoted(criterion, item=True)
    if protocol.eligibility.confirmed:
        yield Said(
            "The experimenter confirms each criterion before a participant's first session, and palpate records that "
            "all are met. Anyone who fails to meet a criterion does not take part, and the record does not show "
            "which criterion it was."
        )
    yield Gap()
    if protocol.consent.required:
        yield Said(
            "Consent is required: no session starts until the participant's consent is on file. Participants consent "
            "to this statement:"
        )
    else:
        yield Said("This protocol does not require consent. Participants are told:")
    yield Quoted(protocol.consent.statement)
    yield Said(
        "No field of a protocol states whether participants learn the full purpose of the study beforehand or only "
        "afterward. Look for this in the quoted texts, or ask the laboratory."
    )


def _recorded(protocol: Protocol) -> Iterator[Block]:
    of_kind = kind_words(protocol.tasks[0]).recorded(protocol)
    yield Said(
        f"The following is recorded under a number and never under a name: {of_kind}what was presented, the level and "
        "dose of the noise, the answer that the "
        f"{'experimenter keyed' if protocol.answers.mode == 'oral' else 'participant gave'} and when, any "
        "corrections, keys that were pressed too early, and every pause and repetition with its reason. The "
        "experimenter can add notes, which are stored with the trial."
    )
    if getattr(protocol, "asked", None):
        yield from import_module("palpate.experiment.protocol.asked.words").recorded(protocol)
    yield from _voices(protocol)
    yield from _sharing(protocol)
    if protocol.consent.kept_months is None:
        yield Said("The protocol does not state how long the data are kept.")
    else:
        kept = count(protocol.consent.kept_months, "month")
        yield Said(
            f"A participant's data are kept for {kept} after their last session. After that, the laboratory must "
            "delete them by hand; palpate reports when this is due."
        )
    yield Said(
        "The data of a participant who withdraws are not analyzed. The laboratory either retains them or has palpate "
        "delete them. No field of a protocol states which, who may see the data, or where they are stored: the consent "
        "statement must tell participants."
    )


def _voices(protocol: Protocol) -> Iterator[Block]:
    if not protocol.answers.microphone:
        yield Said("No microphone is used, and no voice is recorded.")
        return
    yield Said(
        "A microphone is on from the start of the familiarization. For each answer, palpate records when the voice "
        "began, which answer it resembles most, and how closely. Before the trials, each participant says every "
        "answer twice, for comparison. From these samples palpate stores only computed features, not the sound, and "
        "deletes them after the visit."
    )
    if protocol.consent.voice_recordings:
        yield Said(
            "An audio recording of each answer is stored if the participant agrees; participants who do not agree "
            "can still take part. The recordings let a second person check the answers. They stay in the laboratory, "
            "separate from the shared data, and are deleted if the participant withdraws this agreement."
        )
    else:
        yield Said("No sound is stored.")


def _sharing(protocol: Protocol) -> Iterator[Block]:
    if (sharing := protocol.sharing) is None:
        return
    yield Said(
        "The data of participants who agree are shared outside the laboratory. Participants who do not agree can "
        "still take part. Participants who agree can change their minds until the data are shared. Participants are "
        "told:"
    )
    yield Quoted(sharing.statement)
    told = "".join(f", {named(one)}" for one in sharing.facts)
    yield Said(
        "The shared data are the tables of trials and the movement traces, with times measured from the beginning of "
        f"each session. The only facts shared about each person are which task came first{told} and which version of "
        "this protocol applied. On these facts, every participant is identical to at least "
        f"{count(sharing.smallest_group - 1, 'other')}. Voice recordings, session dates, notes, typed reasons and "
        "other free text are not shared."
    )
    if sharing.questionnaires:
        yield Said(
            "Answers to these questionnaires are shared, except free text: "
            f"{', '.join(map(named, sharing.questionnaires))}."
        )
    kept = "stays in the laboratory" if sharing.keep_labels else "is not stored"
    yield Said(f"Participants are given new random labels. The list that links old and new labels {kept}.")


def _procedure(protocol: Protocol) -> Iterator[Block]:
    tasks = protocol.tasks
    pause_s, several = protocol.task_order.break_min_s, len(tasks) > 1
    shortest_s, longest_s = (
        sum(limits) + pause_s * (len(tasks) - 1)
        for limits in zip(*((task.familiarisation.min_s, task.familiarisation.max_s) for task in tasks), strict=True)
    )
    if protocol.task_order.kind == "fixed":
        order = "Participants who do several tasks do them in the order given below (fixed order)."
        yield Said(order if several else "The study has one task.")
    else:
        yield Said(
            "Participants who do several tasks do them in counterbalanced order: permuted blocks give every order to "
            "the same number of participants and stay balanced as participants enroll."
        )
    if getattr(protocol, "groups", ()):
        yield from import_module("palpate.experiment.protocol.designs.groups").blocks(protocol)
    if len({task.participants for task in tasks}) > 1:
        yield Said("If a task has fewer participants than the study, the first participants to enroll do it.")
    if several or pause_s:
        yield Said(f"The break between two tasks lasts at least {number(pause_s)} s ({_minutes(pause_s)}).")
    trials = sum(map(protocol.trials, tasks))
    yield Said(
        f"A participant {'who does every task ' if several else ''}has {_most(*tasks)}{trials} trials; "
        f"familiarization {'and breaks take' if several else 'takes'} {_minutes(shortest_s)} to {_minutes(longest_s)}."
    )
    felt = sum(map(protocol.felt_trials, tasks))
    if felt > trials:
        yield Said(f"Up to {count(felt - trials, 'training trial')} may come first.")
    if protocol.duration is None:
        yield Said("The protocol does not state how long a visit takes.")
        return
    shortest_min, longest_min = protocol.duration.shortest_min, protocol.duration.longest_min
    each_s = max(longest_min * 60 - shortest_s, 0) / felt
    yield Said(
        f"A whole visit{', including all tasks and breaks,' if several else ''} is estimated to take "
        f"{number(shortest_min)} to {number(longest_min)} min. This leaves up to {each_s:.0f} s per trial."
    )


def _most(*tasks: Task) -> str:
    """Return what stands before a number of trials that depends on the answers."""
    return "at most " if any(task.levels for task in tasks) else ""


def _minutes(seconds: float) -> str:
    return f"{number(round(seconds / 60, 1))} min"


def _tasks(protocol: Protocol) -> Iterator[Block]:
    columns = ("task", "participants", f"{_noun(protocol)}s x repetitions = trials", "trials in the study")
    rows = [
        (
            task.id,
            str(task.participants),
            f"{len(protocol.presentations(task))} x {task.repetitions} = {_most(task)}{protocol.trials(task)}",
            f"{_most(task)}{protocol.trials(task) * task.participants}",
        )
        for task in protocol.tasks
    ]
    yield Rows((columns, *rows))
    if paired := design_words(protocol.tasks[0]).pairs(protocol):
        yield Gap()
        yield Said(paired)
    has_others = design_of(protocol.tasks[0].design).named(protocol)
    others = "" if has_others else "; answers may be any of the study's materials"
    for task in protocol.tasks:
        wanted = task.familiarisation
        yield Gap()
        yield Said(f"Task {task.id}:")
        yield facts(
            ("Title", Free(task.title)),
            ("Kind of trial", task.kind),
            ("Design", task.design),
            ("Stimuli", kind_words(task).sources[task.stimulus]),
            *(
                (("Materials", f"only {', '.join(map(named, task.materials))} are presented{others}"),)
                if task.materials
                else ()
            ),
            (
                "Familiarization",
                f"{number(wanted.min_s)} to {number(wanted.max_s)} s before the trials; "
                f"{kind_words(task).familiar(task)}; participants are told:",
            ),
            ("", Free(wanted.instruction)),
            ("Instruction", Free(task.instruction)),
            *(("Picture", f"{one.file}, SHA-256 {one.sha256}") for one in task.pictures or ()),
            *((("Question", Free(protocol.question(task))),) if protocol.question(task) else ()),
            ("Order", _order(task, _noun(protocol))),
            *(_levels().facts(task) if task.levels else ()),
            *((import_module("palpate.experiment.protocol.kinds.phases").fact(task),) if task.phase else ()),
            *(import_module("palpate.experiment.protocol.kinds.ahead").facts(task.ahead) if task.ahead else ()),
            *_control(task),
            *(_training().facts(task) if task.training else ()),
        )


def _training() -> Any:
    """Return the module of training, which only a study with one needs."""
    return import_module("palpate.experiment.protocol.designs.training")


def _control(task: Task) -> Iterator[tuple[str, str | Free]]:
    """Yield what the board reads of a control."""
    if (control := task.control) is not None:
        yield "Control for", f"{control.of}: the vibration makes the same sound, but none of it reaches the skin"
        yield "Arrangement", Free(control.arrangement)
        yield (
            "At chance",
            "if the proportion correct is not significantly above chance, overall or for any participant, and the "
            f"upper end of its 95 % confidence interval is less than {control.margin:g} above chance; every report "
            "states the result",
        )


def _noun(protocol: Protocol) -> str:
    return design_words(protocol.tasks[0]).noun


def _order(task: Task, presented: str) -> str:
    match task.order.kind:
        case "full-random":
            return "full-random: every order of the trials is equally likely"
        case "blocked-random":
            number_of_blocks = count(task.repetitions, "block")
            return f"blocked-random: {number_of_blocks}, each presenting every {presented} once, in random order"
        case "max-run":
            return (
                f"max-run: every order in which no material is presented more than {task.order.max_run} times in a row "
                "is equally likely"
            )


def _materials(protocol: Protocol) -> Iterator[Block]:
    made = frozenset[str]()
    if getattr(protocol, "factors", ()):
        factors = import_module("palpate.experiment.protocol.designs.factors")
        made = factors.combinations(protocol)
        yield from factors.blocks(protocol)
    if ranked := design_words(protocol.tasks[0]).ranked(protocol):
        yield Said(ranked)
    for one in protocol.materials:
        spoken = " or ".join(map(named, one.spoken))
        said = f": participants say {spoken}; the key is [{one.key}]." if one.key is not None else "."
        yield Item(f"{named(one.id)}{said}")
        yield from () if one.id in made else (Quoted(one.description),)


def _stimuli(protocol: Protocol) -> Iterator[Block]:
    yield from kind_words(protocol.tasks[0]).stimuli(protocol)
    masker = protocol.masker
    if any(task.masker is None for task in protocol.tasks):
        yield Said(f"The headphones play {masker.noise} noise.")
    for task in protocol.tasks:
        if task.masker is not None:
            yield Said(f"In task {task.id} the headphones play {task.masker.replace('none', 'no')} noise.")
    yield Said(f"The {masker.level_set_by} sets the noise to a level that meets this criterion:")
    yield Quoted(masker.criterion)
    if (probe := masker.probe) is not None:
        yield Said(
            "In tasks with virtual stimuli, a key can play a vibration while the noise level is set, as "
            f"{named(probe.material)} does under a foot moving at {number(probe.speed_mm_s)} mm/s. Each of these "
            "vibrations is recorded and counts as a stimulus."
        )


def _limits(protocol: Protocol) -> Iterator[Block]:
    exposure, kind = protocol.exposure, kind_words(protocol.tasks[0])
    force = (
        ()
        if exposure.force_peak_n is None
        else (("Force", f"at most {number(exposure.force_peak_n)} N{kind.force(protocol)}"),)
    )
    tasks, touched = len(protocol.tasks), kind.touched(protocol)
    visit_min = number(round(tasks * exposure.session_min + (tasks - 1) * protocol.task_order.break_min_s / 60, 1))
    visit = f"; {visit_min} min for all tasks, with the shortest breaks" if tasks > 1 else ""
    yield facts(
        (
            "Vibration",
            f"at most {number(exposure.vibration_peak_m_s2)} m/s^2 peak, including between samples, computed from the "
            f"measured response of the {touched} and its uncertainty; no session runs if this response has since "
            "changed by 3 dB or more",
        ),
        *force,
        ("Masking noise", f"at most {number(exposure.masker_level_db_a)} dB(A)"),
        ("Dose of noise", "at most the equivalent of 80 dB(A) for 8 hours in any 24 hours, if the rig plays the noise"),
        ("Session", f"at most {number(exposure.session_min)} min for one task{visit}"),
    )
    if protocol.renders:
        yield Said(STOPS, indent="  ")
    for task in protocol.tasks:
        if task.stimulus == "virtual" and (felt := kind_words(task).felt(protocol, task)):
            yield Said(felt, indent="  ")


_ANSWERING = {
    "oral": "Participants answer aloud after each trial, and the experimenter presses the key for what they said",
    "keys": "After each trial, when asked, participants press one of their own buttons. This page names each button "
    "by its key. A press counts without confirmation. The experimenter has the other keys and cannot answer "
    "for the participant",
    "screen": "After each trial, when asked, participants choose one of the answers on their screen by mouse, by "
    "touch or by typing the digit next to it. The choice counts without confirmation. The experimenter has "
    "the other keys and cannot answer for the participant",
}


def _answers(protocol: Protocol) -> Iterator[Block]:
    answers = protocol.answers
    keys = "".join(f"[{key}] {words}, " for key, words in design_words(protocol.tasks[0]).answers(protocol))
    if asked := design_words(protocol.tasks[0]).asked(protocol):
        yield Said(asked)
    yield Said(f"Answers are {answers.mode}. {_ANSWERING[answers.mode]}:")
    yield Said(
        f"{keys}[{answers.no_answer_key}] no answer, [{answers.redo_key}] repeat the trial, [{answers.pause_key}] "
        "pause.",
        indent="    ",
    )
    shown = ", the possible answers during each question" if answers.on_screen or answers.mode == "screen" else ""
    shown += ", and the number of trials done" if answers.progress else ""
    yield Said(
        f"If the rig has a screen for the participant, it shows this protocol's instructions{shown}. palpate adds "
        "short sentences, such as when a trial begins. The rig file can change these sentences, which are not part of "
        "this protocol or its approval. `palpate check` with --rig shows them, and each session stores its rig file."
    )
    if answers.microphone:
        yield Said(
            "Next to the keys, the experimenter sees which answer the microphone appears to have picked up. Only the "
            "key counts."
        )
    if answers.reveal:
        yield Said(
            "During a session, the experimenter can view the levels of the tracks and the answers by material. The "
            "session's record shows whether and when this happened."
        )
    yield Said(
        "If a stimulus may have been felt but the trial has no confirmed answer, the trial is repeated at the end of "
        "its block. The reason may be the repeat key, a pause, a rule below, or a fault in the rig. In a "
        f"blocked-random task, a block presents each {_noun(protocol)} once; any other task is a single block. "
        "Repeats have no limit of their own, but a session pauses after 10 attempts at one trial, and ends at its time "
        "limit."
    )
    leveled = [task.levels is not None for task in protocol.tasks]
    again = " in tasks without levels" if any(leveled) else ""
    again = "" if all(leveled) else f", or{again} repeat a trial that has an answer,"
    yield Said(
        f"The experimenter can correct an answer{again} until the session ends; the record then shows both answers and "
        "the reason."
    )


def _exclusion(protocol: Protocol) -> Iterator[Block]:
    if not protocol.exclusion:
        yield Said("There are no exclusion rules: every trial of every participant counts.")
    for rule in protocol.exclusion:
        condition = _CONDITION[rule.when].format(number(rule.limit or 0))
        yield Item(f"{named(rule.id)}: If {condition}, {_ACTION[rule.action]}. Reason:")
        yield Quoted(rule.reason)


_ACTION = {
    "repeat-trial": "the trial is repeated at the end of its block",
    "exclude-trial": "the trial is excluded",
    "exclude-participant": "the participant is excluded",
}


_CONDITION = {
    "frames-lost": "more than {} tracker frames are lost or damaged between arming and contact",
    "speed-below": "the foot moves at less than {} mm/s",
    "speed-above": "the foot moves at more than {} mm/s",
    "undelivered": "the measured vibration was early, late, distorted or missing, as judged by the rig's thresholds",
    "answers-below": "a participant answers fewer than {} trials in a task",
    "withdrawn": "a participant withdraws",
}


def _analysis(protocol: Protocol) -> Iterator[Block]:
    for planned in protocol.analysis:
        words = design_words(protocol.tasks[0]).tests
        yield Item(_planned(planned, words.get(planned.test, planned.test)))
        for text in (planned.form, planned.question):
            yield from [Quoted(text)] if text else ()


def _planned(planned: PlannedTest, name: str) -> str:
    chance = "" if planned.chance is None else f" of {number(round(planned.chance, 6))}"
    asked = "Question:" if planned.form is None else "Form and question:"
    tasks = f"task{'s' if len(planned.tasks) > 1 else ''} {' and '.join(planned.tasks)}"
    family = "" if planned.correction is None else f"; P adjusted by Holm's method across the {planned.correction}"
    within = "" if planned.margin is None else f" within {number(planned.margin)}"
    of = f" of {' and '.join(map(named, planned.materials))}" if planned.materials else ""
    by = "" if planned.groups is None else f" by {named(planned.groups)}"
    return f"{name}{by}{chance}{within}{of}; {tasks}; alpha {number(planned.alpha)}{family}. {asked}"


def _left_empty(protocol: Protocol) -> Iterator[Block]:
    optional = (("ethics.contact", protocol.ethics.contact), ("duration", protocol.duration))
    empty = [name for name, value in optional if not value]
    unfilled = sealing.unfilled(protocol)
    if not empty and not unfilled:
        yield Said("Nothing: every field is filled in.")
    if empty:
        yield Said("These fields of the protocol file are empty:")
    for name in empty:
        yield Item(name)
    if unfilled:
        yield Said(
            f"These fields are still marked {sealing.UNFILLED}. The protocol can be sealed once they are all filled in:"
        )
    for name in unfilled:
        yield Item(name)


def _odd(protocol: Protocol) -> Iterator[Block]:
    found = advice(protocol)
    if found:
        yield Said("palpate accepts these values, but they may not be what you intended:")
    else:
        yield Said("palpate found no unusual values.")
    for one in found:
        yield Item(f"{one.sentence()}.")


def advice(protocol: Protocol) -> tuple[Finding, ...]:
    """Return each value that is legal but odd, which nothing refuses: its field, and what it would be as a rule."""
    checks = (_unasked_consent, _chances, _open_anovas, _too_few, _orders, _duration, _levels_advice)
    words = kind_words(protocol.tasks[0]), design_words(protocol.tasks[0])
    odd = (mismatch(field, None, got, allowed) for one in words for field, got, allowed in one.odd(protocol))
    drawn = import_module("palpate.experiment.protocol.designs.groups").advice(protocol)
    return (*(problem for check in checks for problem in check(protocol)), *drawn, *odd)


def _unasked_consent(protocol: Protocol) -> Iterator[Finding]:
    if not protocol.consent.required:
        allowed = "usually true; otherwise, a session can start without consent on record"
        yield mismatch("consent.required", None, "false", allowed)


def _chances(protocol: Protocol) -> Iterator[Finding]:
    count = len(protocol.materials)
    for place, test in enumerate(protocol.analysis):
        if test.chance is not None and abs(test.chance * count - 1) > ROUNDED:
            allowed = f"usually {1 / count:.4g}: a guess among {count} materials is correct in 1 of {count} trials"
            yield mismatch(written(("analysis", place, "chance")), None, f"{test.chance:g}", allowed)


def _open_anovas(protocol: Protocol) -> Iterator[Finding]:
    """Give each planned one-way ANOVA that does not name its materials."""
    for place, test in enumerate(protocol.analysis):
        if test.test == "one-way ANOVA" and test.materials is None:
            allowed = "usually the two materials that it compares; without them, its table is exploratory"
            yield mismatch(written(("analysis", place, "materials")), None, "none", allowed)


def _too_few(protocol: Protocol) -> Iterator[Finding]:
    """Yield each planned test by sign flips whose least P, 2^(1 - n) of n participants, is above alpha under Holm."""
    for place, test in enumerate(protocol.analysis):
        people = min((task.participants for task in protocol.tasks if task.id in test.tasks), default=0)
        if not test.test.startswith("sign flips") or not people:
            continue
        materials = len(test.materials or protocol.materials)
        of = {"against chance": materials, "between tasks": comb(len(test.tasks), 2)}
        family = next((count for words, count in of.items() if test.test.endswith(words)), comb(materials, 2))
        family *= len(test.tasks) if test.correction == "materials and tasks" else 1
        tests = max(family, 1) if test.correction else 1
        if tests * 2.0 ** (1 - people) > test.alpha:
            least = next(n for n in range(people, people + 99) if tests * 2.0 ** (1 - n) <= test.alpha)
            told = f"{test.test} with {people} participants, whose smallest possible P is {2.0 ** (1 - people):.3g}"
            told += f", or {tests * 2.0 ** (1 - people):.3g} with Holm's correction" if tests > 1 else ""
            allowed = (
                f"usually {least} or more participants: with fewer, no result can be significant at alpha "
                f"{test.alpha:g}"
            )
            yield mismatch(written(("analysis", place, "test")), None, told, allowed)


def _orders(protocol: Protocol) -> Iterator[Finding]:
    """Yield each group with the same tasks that cannot be divided equally among their orders."""
    if protocol.task_order.kind != "counterbalanced":
        return
    ends = sorted({0, *(task.participants for task in protocol.tasks)})
    for first, last in pairwise(ends):
        own = [place for place, task in enumerate(protocol.tasks) if task.participants >= last]
        people, orders = last - first, factorial(len(own))
        if people % orders:
            field = next(place for place in own if protocol.tasks[place].participants == last)
            told = f"{last}, so {people} participants do {len(own)} tasks"
            allowed = f"usually a multiple of {orders}, so that all {orders} orders are used equally often"
            yield mismatch(written(("tasks", field, "participants")), None, told, allowed)


def _levels_advice(protocol: Protocol) -> Iterator[Finding]:
    yield from _levels().advice(protocol) if _most(*protocol.tasks) else ()


def _levels() -> Any:
    """Return the module of levels, which only a study with them needs."""
    return import_module("palpate.experiment.protocol.levels")


def _duration(protocol: Protocol) -> Iterator[Finding]:
    if protocol.duration is None:
        return
    trials = sum(map(protocol.trials, protocol.tasks))
    trials += sum(task.training.fewest for task in protocol.tasks if task.training)
    besides_s = sum(task.familiarisation.min_s for task in protocol.tasks)
    besides_s += protocol.task_order.break_min_s * (len(protocol.tasks) - 1)
    least_min = (besides_s + LEAST_S * trials) / 60
    if protocol.duration.longest_min < least_min:
        taken = f"{trials} trials of {LEAST_S:g} s, familiarization and breaks"
        allowed = f"usually at least {ceil(least_min)}, the time needed for {taken}"
        yield mismatch("duration.longest_min", None, f"{protocol.duration.longest_min:g}", allowed)
