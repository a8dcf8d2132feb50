"""A new protocol file: from the answers to a few questions, or as a copy of another under an id of its own.

What is written has a comment for every key. What only a laboratory can say stands there as `approval.UNFILLED`: the
study can be practised and rehearsed with it, the board's page lists it, and no seal is given to it. An answer is
checked as the file that it would become, so that what refuses an answer is what would refuse the file.
"""

from __future__ import annotations

import string
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import tomlkit

from experiment import storage
from experiment.errors import PalpateError, ProtocolError
from experiment.protocol import files
from experiment.protocol.approval import UNFILLED
from experiment.protocol.models import Protocol
from experiment.settings import load
from experiment.settings.characters import plain, quoted
from experiment.settings.load import toml
from experiment.storage import Place

NO_ANSWER, REDO, PAUSE = "n", "r", "q"
"""The keys beside those of the materials."""

KEYS = string.ascii_lowercase + string.digits + "!#$%&()*,./:;<=>?@[]^_{|}~"
"""Where the key of a material comes from if no letter of its name is free."""

TASKS = {"virtual": ("virtual",), "real": ("real",), "both": ("virtual", "real")}
"""The tasks that a new study may have: with vibration, with the real objects, or with each."""

SECONDS_A_TRIAL = (25, 50)
"""From which a visit's duration is estimated. Okamoto et al., section 5: 60 to 80 min for 80 trials, with 11 to 15 min
of familiarisation and a break, are 37 to 52 s; short and long visits of a slower and a faster laboratory are ours."""

FAMILIARISATION_S, BREAK_S = (180, 300), 300
"""Before each task, and between two; as in the shipped study."""


def parts(typed: str) -> tuple[str, ...]:
    """Return what was typed between commas."""
    return tuple(part for one in typed.split(",") if (part := one.strip()))


@dataclass(frozen=True)
class NewMaterial:
    """A material's name, its key, and what participants may call it, first what the experimenter is shown."""

    name: str
    key: str
    spoken: tuple[str, ...]

    @property
    def typed(self) -> str:
        """Key and phrases as they are typed."""
        return ", ".join((self.key, *self.spoken))


def materials(typed: Sequence[str]) -> tuple[NewMaterial, ...]:
    """Return materials from `NAME`, or `NAME, KEY, PHRASE, PHRASE`, each.

    Without a key one is a letter of its name that no other has, and without phrases it is called by its name.
    """
    split = [parts(one) or ("",) for one in typed]
    taken = {NO_ANSWER, REDO, PAUSE, *(given[1] for given in split if len(given) > 1)}
    made = []
    for name, *given in split:
        wanted = (one for one in f"{name.lower()}{KEYS}" if one in KEYS and one not in taken)
        key = given[0] if given else next(wanted, NO_ANSWER)
        taken.add(key)
        made.append(NewMaterial(name, key, tuple(given[1:]) or (name,)))
    return tuple(made)


@dataclass(frozen=True)
class NewStudy:
    """What is asked about a new study; what is not answered has these defaults."""

    id: str = "mystudy"
    title: str = "Identification of crinkled materials by a footstep"
    participants: int = 16
    materials: tuple[NewMaterial, ...] = materials(("copy paper", "aluminum foil", "polypropylene", "typing paper"))
    tasks: str = "both"
    repetitions: int = 10


def whole(typed: str, path: Place) -> int:
    """Return a whole number for the field of a protocol at `path`. Raises `PalpateError` for what is none."""
    if typed.isascii() and typed.isdecimal() and len(typed) < 10:
        return int(typed)
    raise PalpateError(f"got {quoted(typed)}; allowed: {load.field(Protocol, path)}")


def checked(study: NewStudy) -> NewStudy:
    """Return a study whose protocol would be accepted. Raises `PalpateError` that says once what would be refused."""
    if study.tasks not in TASKS:
        raise PalpateError(f"got {quoted(study.tasks)}; allowed: one of: {', '.join(TASKS)}")
    _check(text(study))
    return study


def with_material(study: NewStudy, place: int, typed: str) -> NewStudy:
    """Return a study with another `KEY, PHRASE, PHRASE` of one material; those after it take what keys are left.

    Raises `PalpateError` as `checked`.
    """
    before = [f"{one.name}, {one.typed}" for one in study.materials[:place]]
    after = [one.name for one in study.materials[place + 1 :]]
    return checked(replace(study, materials=materials([*before, f"{study.materials[place].name}, {typed}", *after])))


def text(study: NewStudy) -> str:
    """Return the protocol file of a study, with a comment for every key."""
    tasks, count = TASKS[study.tasks], len(study.materials)
    names = _listed([one.name for one in study.materials], "or")
    trials = study.repetitions * count
    pauses_s = BREAK_S * (len(tasks) - 1)
    shortest_s, longest_s = (
        (familiar_s + trials * each_s) * len(tasks) + pauses_s
        for familiar_s, each_s in zip(FAMILIARISATION_S, SECONDS_A_TRIAL, strict=True)
    )
    session_s = FAMILIARISATION_S[1] + trials * SECONDS_A_TRIAL[1]
    known = {
        "id": toml(study.id),
        "title": toml(study.title),
        "participants": f"{study.participants:<23}",
        "unfilled": UNFILLED,
        "no_answer": toml(NO_ANSWER),
        "redo": toml(REDO),
        "pause": toml(PAUSE),
        "shortest_min": str(_up_to(5, shortest_s / 60)),
        "longest_min": str(_up_to(5, longest_s / 60)),
        "session_min": f"{min(240, _up_to(5, 1.2 * session_s / 60)):<24}",
        "order": f"{toml('counterbalanced' if len(tasks) > 1 else 'fixed'):31}",
        "break_s": str(BREAK_S),
        "answers": str(max(1, trials * 9 // 10)),
        "tasks": ", ".join(map(toml, tasks)),
        "chance": f"{1 / max(count, 2)!r:29}",
        "count": str(count),
        "first": toml(study.materials[0].name) if study.materials else '""',
    }
    head, order, rules, both = (string.Template(one).substitute(known) for one in (_STUDY, _ORDER, _RULES, _BOTH))
    blocks = [head, *map(_material, study.materials), order, *(_task(study, task, names) for task in tasks), rules]
    return "\n".join([*blocks, both] if len(tasks) > 1 else blocks)


def copied(source: Path, study_id: str, title: str | None = None) -> str:
    """Return the text of the protocol file `source` under another id, and without the approval of the study there.

    `title` None stands for the title there. Raises `ProtocolError` as `files.load`, and `PalpateError` if the id or the
    title cannot be taken.
    """
    known = files.load(source)
    if study_id == known.study.id:
        raise PalpateError(
            f"got the id {quoted(study_id)}; allowed: another than that of {plain(str(source), keep='')}"
        )
    document = tomlkit.parse(storage.read_text(source).removeprefix("\ufeff"))
    document["study"]["id"] = study_id
    if title is not None and title != known.study.title:
        document["study"]["title"] = title
    for name in ("approval_number", "approved_on", "expires_on"):
        if getattr(known.ethics, name):
            document["ethics"].pop(name)
    made = tomlkit.dumps(document)
    _check(made)
    return made


def free(path: Path) -> Path:
    """Return where a new protocol file goes, with the ending `.toml`. Raises `PalpateError` for what is no such place.

    A name that ends as a seal's would be taken for one.
    """
    path = path if path.suffix else path.with_name(f"{path.name}.toml")
    if path.suffix != ".toml" or path.name.endswith(".seal.toml"):
        raise PalpateError(f"got the file {quoted(str(path))}; allowed: a name that ends in .toml, and not .seal.toml")
    if path.exists() or path.is_symlink():
        raise PalpateError(f"{plain(str(path), keep='')}: got a file that exists; allowed: a new file; name another")
    return path


def _check(made: str) -> None:
    try:
        load.checked(Path("protocol"), Protocol, tomllib.loads(made))
    except ProtocolError as error:
        told = dict.fromkeys(f"got {problem.got}; allowed: {problem.allowed}" for problem in error.problems)
        raise PalpateError("; ".join(told)) from error


def _listed(names: list[str], last: str) -> str:
    """Return names as they are read aloud: `a, b or c`."""
    return f" {last} ".join(part for part in (", ".join(names[:-1]), names[-1] if names else "") if part)


def _up_to(step: int, value: float) -> int:
    """Return the next multiple of `step` from `value` on."""
    return -int(-value // step) * step


def _material(one: NewMaterial) -> str:
    spoken = ", ".join(map(toml, one.spoken))
    return "\n".join(
        (
            "[[materials]]",
            f"id = {toml(one.name)}",
            f"key = {toml(one.key)}",
            f"spoken = [{spoken}]",
            f'description = "{UNFILLED}: what this object is: make, size, weight."',
            "",
        )
    )


_INSTRUCTIONS = {
    "virtual": "Step on the panel, at any speed you like. After each step say aloud which of the materials you felt: ",
    "real": "An object lies under the panel. Step on the panel, at any speed you like. After each step say aloud which "
    "of the materials it was: ",
}
_TITLES = {"virtual": "virtual stimuli", "real": "real stimuli"}


def _task(study: NewStudy, task: str, names: str) -> str:
    return "\n".join(_lines(study, task, TASKS[study.tasks].index(task) + 1, names))


def _lines(study: NewStudy, task: str, number: int, names: str) -> Iterator[str]:
    yield "[[tasks]]"
    yield f"id = {toml(task)}"
    yield f'title = "Task {number}: {_TITLES[task]}"'
    yield 'kind = "footstep"                      # the kind of trial'
    yield f"stimulus = {toml(task)}"
    yield "# What the participant is told."
    yield f"instruction = {toml(_INSTRUCTIONS[task] + names + '.')}"
    yield f"{f'participants = {study.participants}':38} # how many do this task: those who enrol first"
    yield f"{f'repetitions = {study.repetitions}':38} # how often each material is presented"
    yield "# full-random: all trials shuffled; blocked-random: each repetition shuffled by itself; max-run: no material"
    yield "# more often in a row than max_run says."
    yield 'order = { kind = "full-random" }'
    yield ""
    yield "[tasks.familiarisation]                # free handling of the real materials before the task"
    yield f"min_s = {FAMILIARISATION_S[0]}"
    yield f"max_s = {FAMILIARISATION_S[1]}"
    yield 'instruction = "Crinkle the real objects on the panel, as often as you like, until you know them well."'
    yield ""


_STUDY = """\
# The protocol of a study, as `palpate new` wrote it. `palpate check` prints it as the page that an ethics board reads,
# or says what is wrong and on which line. protocols/README.md has a table of every key.
# What says $unfilled is for you to write before a board reads the page; `palpate seal` refuses it until then.
# Every other value is a suggestion: go through them with whoever answers for the study.

format = 2                             # the form of this file

[study]
# The id names the study, its files and the folder of its dataset.
id = $id
title = $title
source = "$unfilled: the publication or the plan that the study follows."
participants = $participants # how many people take part; `palpate power` says how many it takes

[ethics]
board = "$unfilled: the board that approves the study."
statement = "$unfilled: what the board approves, in words."
# Left empty until the board has approved the study: the number on its letter, and whom participants may turn to.
approval_number = ""
contact = ""
# approved_on = 2000-01-01             # the first day on which the study may run; a date has this form
# expires_on = 2001-01-01              # the last day

[eligibility]
# Who may take part: one sentence for each condition.
criteria = [
    "Grown up.",
    "Able to step on a panel with one foot while seated on a chair.",
    "No wound, implant or loss of feeling in the foot that steps.",
    "Hears and speaks well enough to answer aloud with headphones on.",
]

[consent]
required = true                        # no session begins before the participant's consent is on record
# What participants are told and agree to.
statement = \"""
Taking part is voluntary. You may stop at any moment, without giving a reason. You step with one foot, in a sock, on \\
a panel that vibrates or on an object that lies under it, while headphones play noise whose volume you set yourself. \\
We keep the movement of the foot, what was presented and what you answered, under a number and without your name.\"""
voice_recordings = false               # true keeps the sound of spoken answers, of participants who agree to that
kept_months = 120                      # how long data are kept after a participant's last session, then deleted by hand

[duration]
# How long a visit takes, all tasks and breaks included, as participants are told before: an estimate from 25 to 50 s a
# trial. Time a session with a colleague, and correct it.
shortest_min = $shortest_min
longest_min = $longest_min

[exposure]
# Limits that protect the participant, which palpate holds whatever a stimulus asks for.
vibration_peak_m_s2 = 30.0             # the largest acceleration of the panel
masker_level_db_a = 80.0               # the loudest noise; where Directive 2003/10/EC first asks for action, in 8 hours
session_min = $session_min # the longest session: one task of one participant

[masker]
# The noise on the headphones that hides the sound of the panel.
noise = "pink"                         # or white
level_set_by = "participant"           # or experimenter
criterion = "The participant does not hear the panel."    # what must hold at the level that is chosen
# probe = { material = $first, speed_mm_s = 200 }    # what a task with vibration can play meanwhile

[answers]
mode = "oral"                          # the participant says the answer, and the experimenter types its key
on_screen = false                      # true: the participant's screen shows what may be answered
no_answer_key = $no_answer                    # the participant said nothing
redo_key = $redo                         # do the trial again, at the end of its block
pause_key = $pause                        # pause the session
microphone = false                     # true: a microphone hears when the voice begins, and proposes the answer

[footstep.synthesis]
# Of which recordings of the real materials the vibration is made (`palpate record`).
rate_hz = 5000                         # samples a second
samples = 2500                         # samples of a recording: 0.5 s
takes = 3                              # recordings of each material at each speed
speeds_mm_s = [50, 100, 200, 300]      # speeds of the foot at which they are made
average = "magnitude"                  # what of the takes is averaged; or signed
left_out_max = 0.2                     # no rig that cannot carry more than this share of a vibration (rms) is used

[footstep.tactile]
# Frequencies that are felt; the others may be left out where all of them together stay below the floor (rms).
low_hz = 0
high_hz = 500
floor_m_s2 = 0.3
source = "Okamoto et al., Spectrum-based synthesis of vibrotactile stimuli, section 2."

[footstep.step]
# Heights above the panel: between the first two the speed of the foot is measured, and at the last it has landed.
gate_top_mm = 20
gate_bottom_mm = 10
contact_mm = 0

# The materials to tell apart, which are the answers too: the name in tables, the key that the experimenter types, and
# what participants may call it; the first of these is shown to the experimenter.
"""

_ORDER = """\
[task_order]
kind = $order # fixed: as in this file; counterbalanced: each order for as many participants
break_min_s = $break_s                      # the shortest break between two tasks

# Each task: virtual stimuli are vibration; for real ones the experimenter lays out the object before each trial.
"""

_RULES = """\
# What leaves out a trial or a participant, and why. A trial that is repeated comes again at the end of its block.

[[exclusion]]
id = "lost frames"
when = "frames-lost"                   # more frames of the tracker than `limit` are lost or damaged
limit = 20
action = "repeat-trial"                # or exclude-trial
reason = "too much of the foot's movement is missing for its speed to be trusted"

[[exclusion]]
id = "too slow"
when = "speed-below"                   # mm/s
limit = 20
action = "repeat-trial"
reason = "the foot lingered above the panel, far below the slowest recorded speed of 50 mm/s"

[[exclusion]]
id = "too fast"
when = "speed-above"                   # mm/s
limit = 600
action = "repeat-trial"
reason = "the foot came at more than twice the fastest recorded speed of 300 mm/s"

[[exclusion]]
id = "undelivered"
when = "undelivered"                   # the loopback heard the stimulus early, late, changed or not at all
action = "repeat-trial"
reason = "the participant did not feel the stimulus that the trial is about, or felt it apart from the step"

[[exclusion]]
id = "too few answers"
when = "answers-below"                 # answered trials of a task: nine tenths of them
limit = $answers
action = "exclude-participant"
reason = "answer ratios from fewer than nine tenths of a task's trials do not compare with the others"

[[exclusion]]
id = "withdrawn"
when = "withdrawn"
action = "exclude-participant"
reason = "the participant withdrew"

# The planned tests, which the report of `palpate analyse` states.

[[analysis]]
test = "t against chance"
tasks = [$tasks]
alpha = 0.05                           # the level of significance
chance = $chance # the share of right answers of somebody who guesses: one of $count materials
correction = "materials"               # Holm's method adjusts P over the materials of a task; or left out
question = \"""
For each material and task: does the participants' mean ratio of correct answers differ from chance? One-sample t, \\
two-tailed, df = participants - 1; with Cohen's d, and P adjusted by Holm over the materials of a task.\"""
"""

_BOTH = """\
[[analysis]]
test = "two-way ANOVA"
tasks = [$tasks]
alpha = 0.05
question = \"""
Do correct answer ratios depend on the task, over materials? Factors material and task with their interaction, \\
participants as replicates; sums of squares of types I, II and III.\"""

[[analysis]]
test = "ICC"
tasks = [$tasks]
form = "variance components of the two-way ANOVA, mean over all participants"
question = "How reliable are the mean ratios of correct answers, given how much participants differ?"
"""
