"""A new protocol file of footsteps, from the answers to a few questions.

Every key has a comment. Fields that only a laboratory can complete are `UNFILLED`: such a study can be
practiced and rehearsed, not sealed. Each answer is checked as the file that it would become.
"""

import re
import string
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import tomlkit

from palpate.experiment.errors import PalpateError, ProtocolError
from palpate.experiment.protocol.approval.sealing import UNFILLED
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.rules import DEVICES, NO_DEVICE
from palpate.experiment.settings import load
from palpate.experiment.settings.characters import plain, quoted
from palpate.experiment.settings.load import toml
from palpate.experiment.storage import Place

NO_ANSWER, REDO, PAUSE = "n", "r", "q"
"""The keys beside those of the materials."""

OTHER_KEYS = {"answers.no_answer_key": "no answer", "answers.redo_key": "again", "answers.pause_key": "pause"}
"""What they stand for, by their place in the file."""

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
    """Return the materials of `NAME` or `NAME, KEY, PHRASE, ...`, by default with a free letter and the name."""
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
    raise PalpateError(f"got {quoted(typed)}", allowed=load.field(ProtocolFile, path))


def checked(study: NewStudy) -> NewStudy:
    """Return a study whose protocol would be accepted. Raises `PalpateError` that says once what would be refused."""
    if study.tasks not in TASKS:
        raise PalpateError(f"got {quoted(study.tasks)}", allowed=f"one of: {', '.join(TASKS)}")
    check(text(study), study.materials)
    return study


def with_material(study: NewStudy, place: int, typed: str) -> NewStudy:
    """Return the study with another `KEY, PHRASE, PHRASE` for one material. Raises `PalpateError` as `checked`."""
    before = [f"{one.name}, {one.typed}" for one in study.materials[:place]]
    after = [one.name for one in study.materials[place + 1 :]]
    return checked(replace(study, materials=materials([*before, f"{study.materials[place].name}, {typed}", *after])))


def text(study: NewStudy) -> str:
    """Return the protocol file of a study, with a comment for every key."""
    tasks, count = TASKS[study.tasks], len(study.materials)
    *others, last = [one.name for one in study.materials] or [""]
    names = " or ".join(filter(None, (", ".join(others), last)))
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
        "repetitions": f"{study.repetitions:<24}",
        "familiar_min_s": str(FAMILIARISATION_S[0]),
        "familiar_max_s": str(FAMILIARISATION_S[1]),
        "unfilled": UNFILLED,
        "no_answer": toml(NO_ANSWER),
        "redo": toml(REDO),
        "pause": toml(PAUSE),
        "shortest_min": str(_in_fives(shortest_s / 60)),
        "longest_min": str(_in_fives(longest_s / 60)),
        "session_min": f"{min(240, _in_fives(1.2 * session_s / 60)):<24}",
        "order": f"{toml('counterbalanced' if len(tasks) > 1 else 'fixed'):31}",
        "break_s": str(BREAK_S),
        "answers": str(max(1, trials * 9 // 10)),
        "tasks": ", ".join(map(toml, tasks)),
        "chance": f"{1 / max(count, 2)!r:29}",
        "count": str(count),
        "first": toml(study.materials[0].name) if study.materials else '""',
    }
    template = Path(__file__).with_name("study.template").read_text("utf-8")
    _, *named = re.split(r"^## (.*)\n", template, flags=re.MULTILINE)
    part = {name: string.Template(lines) for name, lines in zip(named[::2], named[1::2], strict=True)}
    answers = (
        {"id": toml(one.name), "key": toml(one.key), "spoken": ", ".join(map(toml, one.spoken))}
        for one in study.materials
    )
    told = (
        {"id": toml(task), "number": str(number), "title": _TITLES[task]}
        | {"instruction": toml(f"{_INSTRUCTIONS[task]}{names}.")}
        for number, task in enumerate(tasks, start=1)
    )
    return "\n".join(
        (
            part["study"].substitute(known),
            *(part["material"].substitute(known | one) for one in answers),
            part["order"].substitute(known),
            *(part["task"].substitute(known | one) for one in told),
            *(part[name].substitute(known) for name in ("rules", "both")[: len(tasks)]),
        )
    )


def controlled(text: str) -> str:
    """Return the text of a protocol with a control of its first virtual task, in all else alike, done by as many.

    Raises `PalpateError` for a protocol that cannot have one, as one without a virtual identification.
    """
    document = tomlkit.parse(text)
    virtual = [one for one in document["tasks"] if one["stimulus"] == "virtual"]
    if not virtual or "control" in [one["id"] for one in document["tasks"]]:
        raise PalpateError("got --control", allowed="a protocol with a virtual task and without a task 'control'")
    made = tomlkit.parse(tomlkit.dumps({"tasks": [virtual[0].unwrap()]}))["tasks"][0]
    table = {"of": made["id"], "arrangement": ARRANGEMENT}
    made.update({"id": "control", "title": f"Control of {made['title']}", "control": table})
    lines, place = text.splitlines(keepends=True), _ends_of_tasks(text)[-1]
    lines[place:place] = ["\n", tomlkit.dumps({"tasks": [made.unwrap()]}).rstrip(), "\n"]
    document = tomlkit.parse("".join(lines))
    trials = made["repetitions"] * len(made.get("materials") or document.get("materials", ()))
    familiar, break_s = made.get("familiarisation", {}), document["task_order"]["break_min_s"]
    return _longer(document, trials, [break_s + familiar.get(one, 0) for one in ("min_s", "max_s")])


def trained(text: str, trials: int) -> str:
    """Return the text of a protocol whose tasks each begin with a training of so many trials, with feedback.

    Raises `PalpateError` for a number of trials, or a protocol, that cannot have one.
    """
    lines = text.splitlines(keepends=True)
    places = _ends_of_tasks(text)
    for place in reversed(places):
        lines[place:place] = ["\n", "[tasks.training]\n", f"trials = {trials}\n", "feedback = true\n"]
    try:
        return _longer(tomlkit.parse("".join(lines)), trials * len(places), (0, 0))
    except PalpateError as error:
        raise PalpateError(
            f"--training {trials}", "this study cannot have training", allowed=error.finding.allowed
        ) from error


def _longer(document: Any, trials: int, more_s: Sequence[float]) -> str:
    """Return the text of a document of the newest format, whose session has more trials, and takes so many s more."""
    if "duration" in document:
        ends = zip(("shortest_min", "longest_min"), more_s, SECONDS_A_TRIAL, strict=True)
        for key, beside_s, each_s in ends:
            document["duration"][key] += _in_fives((beside_s + trials * each_s) / 60)
    document["format"] = max(get_args(ProtocolFile.model_fields["format"].annotation))
    written = tomlkit.dumps(document)
    check(written)
    return written


def _ends_of_tasks(text: str) -> list[int]:
    """Return the lines after each task, before the comment of what follows."""
    lines = text.splitlines()
    heads = [number for number, line in enumerate(lines) if line.startswith("[")]
    ends = []
    for head, following in pairwise([*heads, len(lines)]):
        if lines[head].startswith(("[[tasks", "[tasks")) and not "".join(lines[following : following + 1]).startswith(
            "[tasks"
        ):
            ends.append(1 + max(k for k in range(head, following) if lines[k].strip() and not lines[k].startswith("#")))
    return ends


ARRANGEMENT = (
    "A bridge supports the foot: it stands on the floor on both sides of the panel and touches neither the panel nor "
    "its mount. The panel vibrates below it as in the other task."
)
"""What a control needs, for a laboratory to word; ours."""


def free(path: Path) -> Path:
    """Return where a new protocol file goes, ending in `.toml`. Raises `PalpateError`, also for a seal's name."""
    path = path if path.suffix else path.with_name(f"{path.name}.toml")
    if path.suffix != ".toml" or path.name.endswith(".seal.toml"):
        raise PalpateError(
            f"got the file {quoted(str(path))}", allowed="a name that ends in .toml but not in .seal.toml"
        )
    if path.exists() or path.is_symlink():
        raise PalpateError(plain(str(path), keep=""), "this file already exists", "name another", allowed="a new file")
    return path


def check(made: str, of: Sequence[NewMaterial] = ()) -> None:
    """Refuse a file for the first of its problems, in words of what was asked about the study and its materials."""
    document = tomllib.loads(made)
    if (got := document["study"]["id"]) in DEVICES:  # of any format: what is new has no files to keep
        raise PalpateError(f"got {quoted(got)}", allowed=NO_DEVICE)
    try:
        load.checked(Path("protocol"), ProtocolFile, document)
    except ProtocolError as error:
        problem = error.findings[0]
        got, allowed = problem.got, problem.allowed
        if problem.field == "materials":
            got, allowed = f"{len(of)} material{'' if len(of) == 1 else 's'}", "two materials or more"
        elif problem.field in OTHER_KEYS:
            got, allowed = f"the key {got}, which is already used for '{OTHER_KEYS[problem.field]}'", "a unique key"
        allowed = re.sub(r"materials\[(\d+)\]\.\S+", lambda one: quoted(of[int(one[1])].name), allowed)
        raise PalpateError(f"got {got}", allowed=allowed) from error


def _in_fives(value: float) -> int:
    """Return the next multiple of 5 from a value on."""
    return -int(-value // 5) * 5


_INSTRUCTIONS = {
    "virtual": "Step on the panel, at any speed you like. After each step, say aloud which of the materials you felt: ",
    "real": "An object lies under the panel. Step on the panel, at any speed you like. After each step, say aloud "
    "which of the materials it was: ",
}
_TITLES = {"virtual": "virtual stimuli", "real": "real stimuli"}
