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
    "Software alone keeps all of these limits, and software is no safety function. In hardware, a laboratory limits "
    "what its amplifier can deliver, and an emergency stop cuts the power. palpate runs nobody on a force device, or "
    "an actuator that can exceed the limit of vibration, unless its rig file names both and the day on which they were "
    "tried. The participant stops everything with a pedal, or a key at the screen, within 0.2 s; where a rig has "
    "neither, by word of mouth alone."
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
    known: list[Block] = [Said(f"{state} This was so on {today}."), *([approval_of(seal)] if seal else [])]
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
            f"<section><h2>Of a rig; no part of the protocol or its seal</h2>{rendering.html_blocks(rig)}</section>"
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
        "the name of the file, and an approval holds for this version alone.",
        indent="  ",
    )
    yield Said(
        "Text behind a bar or between double quotes is quoted from the file word for word. Everything else on this "
        "page is written by palpate from the values in the file, and these values hold whatever a text may say.",
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
        f"The study has {count(protocol.study.participants, 'participant')}. Everyone who takes part meets all of "
        "these criteria:"
    )
    for criterion in protocol.eligibility.criteria:
        yield Quoted(criterion, item=True)
    if protocol.eligibility.confirmed:
        yield Said(
            "The experimenter confirms each of them before a participant's first session. That all are met is on "
            "record; who does not meet one is not run, and which one it was is not recorded."
        )
    yield Gap()
    if protocol.consent.required:
        yield Said(
            "Consent is required: no session starts before the participant's consent is on file. Participants consent "
            "to this statement:"
        )
    else:
        yield Said("This protocol does not require consent. Participants are told:")
    yield Quoted(protocol.consent.statement)
    yield Said(
        "Whether they are told the whole purpose of the study before it, or only after it, no field of a protocol "
        "states: it is to be read in its texts, or asked."
    )


def _recorded(protocol: Protocol) -> Iterator[Block]:
    of_kind = kind_words(protocol.tasks[0]).recorded(protocol)
    yield Said(
        f"The following is recorded under a number and never under a name: {of_kind}"
        "what was presented, the level and the dose of the noise, the answer that the "
        f"{'experimenter keyed' if protocol.answers.mode == 'oral' else 'participant gave'} and when, its corrections, "
        "keys that were pressed too early, and every pause and "
        "repetition with its reason. The experimenter can add notes, which are kept with the trial."
    )
    if getattr(protocol, "asked", None):
        yield from import_module("palpate.experiment.protocol.asked.words").recorded(protocol)
    yield from _voices(protocol)
    yield from _sharing(protocol)
    if protocol.consent.kept_months is None:
        yield Said("The protocol does not state how long data are kept.")
    else:
        kept = count(protocol.consent.kept_months, "month")
        yield Said(
            f"A participant's data are kept for {kept} after their last session. Then they are to be deleted, by hand; "
            "palpate tells the laboratory when."
        )
    yield Said(
        "The data of a participant who withdraws are not analysed. They are kept, or deleted if the laboratory asks "
        "palpate for that. No field of a protocol states which: what participants are told decides."
    )


def _voices(protocol: Protocol) -> Iterator[Block]:
    if not protocol.answers.microphone:
        yield Said("No microphone listens, and no voice is recorded.")
        return
    yield Said(
        "A microphone listens from the familiarisation on. Recorded of each answer are the time at which the voice "
        "began, which answer it resembles most, and how much. Before the trials each participant says every answer "
        "twice, to compare with; what is computed from that, which is no sound, is deleted after the visit."
    )
    if protocol.consent.voice_recordings:
        yield Said(
            "The sound of each answer is kept if the participant agrees to that; whoever does not agree takes part all "
            "the same. It is kept apart from what is shared, for the laboratory alone, so that a second person can "
            "listen to what was said. Whoever takes the agreement back has it deleted."
        )
    else:
        yield Said("No sound is kept.")


def _sharing(protocol: Protocol) -> Iterator[Block]:
    if (sharing := protocol.sharing) is None:
        return
    yield Said(
        "Data of participants who agree to it are shared outside of the laboratory. Whoever does not agree takes part "
        "all the same, and an agreement can be taken back until the data are shared. Participants are told:"
    )
    yield Quoted(sharing.statement)
    told = "".join(f", {named(one)}" for one in sharing.facts)
    yield Said(
        "Shared are the tables of trials and the traces of movement, with times from the beginning of each session. Of "
        f"a person no more is shared than which task came first{told} and which version of this protocol held: in "
        f"these, every participant is like {count(sharing.smallest_group - 1, 'other')} or more. Voices, days of "
        "sessions, notes, typed reasons and other free text are not shared."
    )
    if sharing.questionnaires:
        yield Said(f"Shared of questionnaires is all but texts: {', '.join(map(named, sharing.questionnaires))}.")
    kept = "is kept in the laboratory" if sharing.keep_labels else "is not kept"
    yield Said(f"Labels are drawn anew, and which label a participant gets {kept}.")


def _procedure(protocol: Protocol) -> Iterator[Block]:
    tasks = protocol.tasks
    pause_s = protocol.task_order.break_min_s
    shortest_s, longest_s = (
        sum(limits) + pause_s * (len(tasks) - 1)
        for limits in zip(*((task.familiarisation.min_s, task.familiarisation.max_s) for task in tasks), strict=True)
    )
    if protocol.task_order.kind == "fixed":
        yield Said("Participants who do several tasks do them in the order given below (fixed order).")
    else:
        yield Said(
            "Participants who do several tasks do them in counterbalanced order: every order is given to the same "
            "number of participants, by permuted blocks, so that the orders stay balanced while participants enrol."
        )
    if getattr(protocol, "groups", ()):
        yield from import_module("palpate.experiment.protocol.designs.groups").blocks(protocol)
    if len({task.participants for task in tasks}) > 1:
        yield Said("If a task has fewer participants than the study, those who enrol first do it.")
    yield Said(f"The break between two tasks lasts at least {number(pause_s)} s ({_minutes(pause_s)}).")
    trials = sum(map(protocol.trials, tasks))
    yield Said(
        f"A participant who does every task has {_most(*tasks)}{trials} trials; familiarisation and breaks take "
        f"{_minutes(shortest_s)} to {_minutes(longest_s)}."
    )
    felt = sum(map(protocol.felt_trials, tasks))
    if felt > trials:
        yield Said(f"Before these come at most {count(felt - trials, 'trial')} of training.")
    if protocol.duration is None:
        yield Said("The protocol does not state how long a visit takes.")
        return
    shortest_min, longest_min = protocol.duration.shortest_min, protocol.duration.longest_min
    each_s = max(longest_min * 60 - shortest_s, 0) / felt
    yield Said(
        f"A whole visit, all tasks and breaks included, is estimated to take {number(shortest_min)} to "
        f"{number(longest_min)} min. That leaves up to {each_s:.0f} s for each trial."
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
                (("Materials", f"{', '.join(map(named, task.materials))} alone are presented{others}"),)
                if task.materials
                else ()
            ),
            ("Familiarisation", f"{number(wanted.min_s)} to {number(wanted.max_s)} s; participants are told:"),
            ("", Free(wanted.instruction)),
            ("Instruction", Free(task.instruction)),
            *(("Picture", f"{one.file}, SHA-256 {one.sha256}") for one in task.pictures or ()),
            *((("Asked", Free(protocol.question(task))),) if protocol.question(task) else ()),
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
        yield "Control of", f"{control.of}: the vibration sounds as it does there, and nothing of it reaches the skin"
        yield "Arrangement", Free(control.arrangement)
        yield (
            "At chance",
            f"if neither all answers nor those of any participant are right more often, and the mean share is less "
            f"than {control.margin:g} above chance; this is stated in every report",
        )


def _noun(protocol: Protocol) -> str:
    return design_words(protocol.tasks[0]).noun


def _order(task: Task, presented: str) -> str:
    match task.order.kind:
        case "full-random":
            return "full-random: every order of the trials is equally likely"
        case "blocked-random":
            number_of_blocks = count(task.repetitions, "block")
            return f"blocked-random: {number_of_blocks}, each with every {presented} once, in random order"
        case "max-run":
            return (
                f"max-run: every order in which no material is presented more than {task.order.max_run} times in a row "
                "is equally likely"
            )


def _materials(protocol: Protocol) -> Iterator[Block]:
    made = frozenset[str]()
    if getattr(protocol, "factors", ()):
        factors = import_module("palpate.experiment.protocol.designs.factors")
        made = frozenset(factors.crossed(protocol))
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
    yield Said(f"The {masker.level_set_by} sets the level of the noise so that:")
    yield Quoted(masker.criterion)
    if (probe := masker.probe) is not None:
        yield Said(
            f"While the level is set, the panel vibrates as {named(probe.material)} does under a foot at "
            f"{number(probe.speed_mm_s)} mm/s whenever a key asks for it, in tasks with virtual stimuli. Each time is "
            "on record and counts as a stimulus."
        )


def _limits(protocol: Protocol) -> Iterator[Block]:
    exposure = protocol.exposure
    force = () if exposure.force_peak_n is None else (("Force", f"at most {number(exposure.force_peak_n)} N"),)
    yield facts(
        (
            "Vibration",
            f"at most {number(exposure.vibration_peak_m_s2)} m/s^2 peak, between samples too, by the measured response "
            "of the panel with its uncertainty; nobody is run on a panel that moves 3 dB more or less than measured",
        ),
        *force,
        ("Masking noise", f"at most {number(exposure.masker_level_db_a)} dB(A)"),
        ("Dose of noise", "where the rig plays it, at most that of 80 dB(A) for 8 hours in any 24 hours"),
        ("Session", f"at most {number(exposure.session_min)} min for one task"),
    )
    if protocol.renders:
        yield Said(STOPS, indent="  ")
    for task in protocol.tasks:
        if task.stimulus == "virtual" and (felt := kind_words(task).felt(protocol, task)):
            yield Said(felt, indent="  ")


_ANSWERING = {
    "oral": "Participants answer aloud after each trial, and the experimenter presses the key for what they said",
    "keys": "Participants press one of their own buttons after each trial, once they are asked; a button has the name "
    "of its key here, and its press counts without confirmation. The experimenter has the other keys, and cannot "
    "answer for them",
    "screen": "Participants choose one of the answers on their screen after each trial, by mouse, touch or the digit "
    "beside it, once they are asked; that counts without confirmation. The experimenter has the other keys, and cannot "
    "answer for them",
}


def _answers(protocol: Protocol) -> Iterator[Block]:
    answers = protocol.answers
    keys = "".join(f"[{key}] {words}, " for key, words in design_words(protocol.tasks[0]).answers(protocol))
    if asked := design_words(protocol.tasks[0]).asked(protocol):
        yield Said(asked)
    yield Said(f"Answers are {answers.mode}. {_ANSWERING[answers.mode]}:")
    yield Said(
        f"{keys}[{answers.no_answer_key}] no answer, [{answers.redo_key}] do the trial again, "
        f"[{answers.pause_key}] pause.",
        indent="    ",
    )
    shown = ", and these answers while they answer" if answers.on_screen or answers.mode == "screen" else ""
    shown += ", and how many trials are answered" if answers.progress else ""
    yield Said(
        f"Where the rig has a screen for the participant, it shows the instructions of this protocol{shown}. It adds "
        "short sentences, such as when to step, which may stand in the rig file: they are no part of this protocol and "
        "of its approval. `palpate check` with --rig shows them, and each session keeps its rig file."
    )
    if answers.microphone:
        yield Said(
            "Beside the keys the experimenter sees which answer the microphone seems to have heard. The key decides."
        )
    if answers.reveal:
        yield Said(
            "During a session the experimenter may see the levels of tracks and the answers by material. The session's "
            "record shows whether and when."
        )
    yield Said(
        "A trial whose stimulus may have been felt, and which has no confirmed answer, is repeated at the end of its "
        "block, whatever the cause: the key, a pause, a rule below, or a fault of the rig. In a task whose order is "
        f"blocked-random, a block presents each {_noun(protocol)} once; any other "
        "task is one single block. The experimenter "
        "can correct an answer until the session ends; the record then holds both, and the reason."
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
    "exclude-trial": "the trial is left out",
    "exclude-participant": "the participant is left out",
}


_CONDITION = {
    "frames-lost": "more than {} frames of the tracker are lost or damaged between arming and contact",
    "speed-below": "the foot moves at less than {} mm/s",
    "speed-above": "the foot moves at more than {} mm/s",
    "undelivered": "the vibration, as measured, was early, late, changed or missing by the rig's thresholds",
    "answers-below": "a participant answers fewer than {} trials of a task",
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
    family = "" if planned.correction is None else f"; P adjusted by Holm's method over the {planned.correction}"
    within = "" if planned.margin is None else f" within {number(planned.margin)}"
    of = f" of {' and '.join(map(named, planned.materials))}" if planned.materials else ""
    by = "" if planned.groups is None else f" by {named(planned.groups)}"
    return f"{name}{by}{chance}{within}{of}; {tasks}; alpha {number(planned.alpha)}{family}. {asked}"


def _left_empty(protocol: Protocol) -> Iterator[Block]:
    optional = (("ethics.contact", protocol.ethics.contact), ("duration", protocol.duration))
    empty = [name for name, value in optional if not value]
    unfilled = sealing.unfilled(protocol)
    if not empty and not unfilled:
        yield Said("Nothing is left: every field is filled in.")
    if empty:
        yield Said("These fields of the protocol file are empty:")
    for name in empty:
        yield Item(name)
    if unfilled:
        yield Said(f"These still say {sealing.UNFILLED}, and the protocol can be sealed once none does:")
    for name in unfilled:
        yield Item(name)


def _odd(protocol: Protocol) -> Iterator[Block]:
    found = advice(protocol)
    if found:
        yield Said("These values are allowed, and may not be what is meant; nothing refuses them:")
    else:
        yield Said("palpate finds no value that is allowed and unlikely to be meant.")
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
        allowed = "as a rule true: without it a session begins although nobody has agreed on record"
        yield mismatch("consent.required", None, "false", allowed)


def _chances(protocol: Protocol) -> Iterator[Finding]:
    count = len(protocol.materials)
    for place, test in enumerate(protocol.analysis):
        if test.chance is not None and abs(test.chance * count - 1) > ROUNDED:
            allowed = (
                f"as a rule {1 / count:.4g}: who guesses among {count} materials is right in one of {count} trials"
            )
            yield mismatch(written(("analysis", place, "chance")), None, f"{test.chance:g}", allowed)


def _open_anovas(protocol: Protocol) -> Iterator[Finding]:
    """Give each planned one-way ANOVA that does not name its materials."""
    for place, test in enumerate(protocol.analysis):
        if test.test == "one-way ANOVA" and test.materials is None:
            allowed = "as a rule the two materials that it compares: without them its table is exploratory"
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
            told = f"{test.test} of {people} participants, whose least P is {2.0 ** (1 - people):.3g}"
            told += f", {tests * 2.0 ** (1 - people):.3g} by Holm" if tests > 1 else ""
            allowed = f"as a rule {least} participants or more: with fewer nothing can be shown at alpha {test.alpha:g}"
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
            told = f"{last}, so that {people} do {len(own)} tasks"
            allowed = (
                f"as a rule a multiple of {orders} who do them: each of their {orders} orders as often as any other"
            )
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
        taken = f"{trials} trials of {LEAST_S:g} s, familiarisation and breaks"
        allowed = f"as a rule at least {ceil(least_min)}, which {taken} take"
        yield mismatch("duration.longest_min", None, f"{protocol.duration.longest_min:g}", allowed)
