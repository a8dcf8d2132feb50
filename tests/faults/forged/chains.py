"""Forged journals and rosters: lines and heads damaged, and whole chains written anew with a head that fits."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

from palpate.experiment import storage
from palpate.experiment.dataset import build
from palpate.experiment.errors import DatasetError
from palpate.experiment.records import chain
from palpate.experiment.study.people import enrolling
from palpate.experiment.study.roster import Roster
from tests.experiment.dataset.studies import DAY
from tests.faults.anchors import HIDES, forge, smuggle
from tests.faults.forged.case import (
    Act,
    At,
    Case,
    Forgery,
    append_bytes,
    ask_register,
    delete,
    first_journal,
    forge_line,
    in_turn,
    last_lines_cut,
    make_folder,
    random_journal,
    roster,
)
from tests.faults.forged.studies import REASON, Lines, read_lines, write_chain

STUDIES = ("visits", "pairs", "people", "study")
JOURNALED = (*STUDIES, "rehearsed pairs", "practice")

Damage = Callable[[Case, list[bytes]], list[bytes]]
"""Changes the lines of a file, whose head stays."""


def _without_line(case: Case, lines: list[bytes]) -> list[bytes]:
    place = case.choose("line", range(len(lines)))
    return [*lines[:place], *lines[place + 1 :]]


def _doubled_line(case: Case, lines: list[bytes]) -> list[bytes]:
    place = case.choose("line", range(len(lines)))
    return [*lines[: place + 1], *lines[place:]]


def _broken_line(case: Case, lines: list[bytes]) -> list[bytes]:
    place = case.choose("line", range(len(lines)))
    return [*lines[:place], lines[place][:-1], *lines[place + 1 :]]


def _last_lines_cut(case: Case, lines: list[bytes]) -> list[bytes]:
    return lines[: -case.choose("lines less:", range(1, 4))]


def _damage(at: At, damage: Damage) -> Act:
    def act(case: Case) -> None:
        path = at(case)
        lines = damage(case, path.read_bytes().split(b"\n")[:-1])
        path.write_bytes(b"".join(line + b"\n" for line in lines))

    return act


HEADS: dict[str, Callable[[list[bytes]], bytes]] = {
    "emptied": lambda _: b"",
    "two lines older": lambda lines: _head(lines[:-2]),
    "one line older": lambda lines: _head(lines[:-1]),
    "with another hash": lambda lines: f"{len(lines):012d} {'0' * 64}\n".encode(),
    "another text": lambda _: b"17\n",
    "not ASCII": lambda _: b"\xff\n",
}


def _head(lines: list[bytes]) -> bytes:
    return f"{len(lines):012d} {hashlib.sha256(lines[-1]).hexdigest()}\n".encode()


def _write_head(content: Callable[[list[bytes]], bytes]) -> Act:
    """Give a journal another head, made from its lines."""

    def act(case: Case) -> None:
        path = random_journal(case)
        chain.head_path(path).write_bytes(content(path.read_bytes().split(b"\n")[:-1]))

    return act


Rewrite = Callable[[Case, Lines], Lines]


def _anew(at: At, rewrite: Rewrite) -> Act:
    """Write a journal or a roster with other lines, each with the hash of the one before, and a head that fits."""

    def act(case: Case) -> None:
        path = at(case)
        write_chain(path, rewrite(case, read_lines(path)))

    return act


def _places(lines: Lines, kind: str) -> list[int]:
    return [place for place, (_, entry) in enumerate(lines) if entry["kind"] == kind]


def _changed_entry(lines: Lines, place: int, **changed: object) -> Lines:
    t_ns, entry = lines[place]
    return [*lines[:place], (t_ns, {**entry, **changed}), *lines[place + 1 :]]


def _with_other(kind: str, **changed: object) -> Rewrite:
    """Change an entry of a kind."""
    return lambda case, lines: _changed_entry(lines, case.choose(kind, _places(lines, kind)), **changed)


def _without(kind: str) -> Rewrite:
    """Leave an entry of a kind out."""

    def rewrite(case: Case, lines: Lines) -> Lines:
        place = case.choose(kind, _places(lines, kind))
        return [*lines[:place], *lines[place + 1 :]]

    return rewrite


def _other_answer(case: Case, lines: Lines) -> Lines:
    """Another answer of the same session takes the place of one."""
    given = sorted({str(lines[place][1]["answered"]) for place in _places(lines, "answer")})
    place = case.choose("answer", _places(lines, "answer"))
    return _changed_entry(lines, place, answered=next(one for one in given if one != lines[place][1]["answered"]))


def _second_header(case: Case, lines: Lines) -> Lines:
    place = case.choose("line", range(1, len(lines)))
    return [*lines[:place], lines[0], *lines[place:]]


def _unknown_kind(case: Case, lines: Lines) -> Lines:
    return _changed_entry(lines, case.choose("line", range(1, len(lines))), kind="thought")


def _redo(case: Case, lines: Lines) -> Lines:
    """An attempt is repeated for a reason that no table can hold."""
    place = case.choose("answer", _places(lines, "answer"))
    t_ns, entry = lines[place]
    redo = {"kind": "redo", "trial": entry["trial"], "attempt": entry["attempt"], "reason": "a\tb", "put_off": False}
    return [*lines[: place + 1], (t_ns, redo), *lines[place + 1 :]]


def _foreign_material(case: Case, lines: Lines) -> Lines:
    order: Any = lines[0][1]["order"]
    place = case.choose("trial", range(len(order)))
    trial = {**order[place], "presented": ["sand", *order[place]["presented"][1:]]}
    return _changed_entry(lines, 0, order=[*order[:place], trial, *order[place + 1 :]])


def _withdrawal(_: Case, lines: Lines) -> Lines:
    return [*lines, (lines[-1][0], {"kind": "withdrawal", "reason": REASON, "torn": ""})]


HEADERS: dict[str, object] = {
    "purpose": "PILOT",
    "study": "other",
    "protocol_sha256": "0" * 64,
    "seed": 17,
    "task_position": 5,
    "block_trials": 7,
    "participant": "99",
    "task": "other",
}


def _other_header(case: Case, lines: Lines) -> Lines:
    field = case.choose("field", list(HEADERS))
    return _changed_entry(lines, 0, **{field: HEADERS[field]})


JOURNALS: tuple[tuple[str, tuple[str, ...], Rewrite], ...] = (
    ("an answer changed", JOURNALED, _other_answer),
    ("an entry of an unknown kind", JOURNALED, _unknown_kind),
    ("a second header", JOURNALED, _second_header),
    ("a header of an older format", JOURNALED, _with_other("header", format=4)),
    ("another field of its header", ("rehearsed pairs", "pairs", "practice", "pilot"), _other_header),
    ("another session's id in a rehearsal", ("rehearsal",), _with_other("header", session_id="0" * 32)),
    ("another rig in a rehearsal's header", ("rehearsed pairs",), _with_other("header", rig_sha256="0" * 64)),
    ("a trial with what no task presents", ("pairs", "study", "rehearsed pairs"), _foreign_material),
    ("no opening of its tracker", ("study", "pilot"), _without("tracker")),
    ("a repeated attempt whose reason has a tab", ("pairs", "study"), _redo),
    ("its footer left out", ("study", "people", "rehearsed pairs"), _without("footer")),
    ("a withdrawal that the roster lacks", ("study", "pairs"), _withdrawal),
)
"""What is forged in a journal that is written anew, with its head."""


def _enrolled(participant: str, **more: object) -> dict[str, object]:
    return {"kind": "enrolled", "participant": participant, "consent_on": str(DAY), **more}


def _entry(kind: str, participant: str, **more: object) -> dict[str, object]:
    return {"kind": kind, "participant": participant, **more}


GONE = _entry("withdrawn", "03", reason=REASON)
ROSTERS: dict[str, list[dict[str, object]]] = {
    "a label that is not the next": [_enrolled("09")],
    "a label twice": [_enrolled("01")],
    "a first participant twice": [_enrolled("04", kind="first", format=1, seed_sha256="0" * 64)],
    "a place that is not free": [_enrolled("04", kind="replacing", takes="01")],
    "a consent twice": [_entry("consented", "03", consent_on=str(DAY))],
    "a correction of no consent": [
        _enrolled("04", consent_on=None),
        _entry("corrected", "04", consent_on=str(DAY), reason="the letter says so"),
    ],
    "a consent of somebody unknown": [_entry("consented", "77", consent_on=str(DAY))],
    "a withdrawal twice": [GONE, GONE],
    "a consent after the withdrawal": [GONE, _entry("consented", "03", consent_on=str(DAY))],
    "an erasure without a withdrawal": [_entry("erased", "03")],
    "an erasure twice": [GONE, _entry("erased", "03"), _entry("erased", "03")],
    "a withdrawal of somebody without a session": [GONE],
    "an entry of an unknown kind": [_entry("thought", "01")],
    "a line older than the one before": [_entry("revealed", "01", revealed_on=str(DAY))],
}
"""Lines that are added to the roster of a study, with a chain and a head that fit."""


def _with_entries(entries: list[dict[str, object]]) -> Rewrite:
    return lambda _, lines: [*lines, *((0, entry) for entry in entries)]


def _build(case: Case) -> None:
    build.build(case.root)


def _smuggle(case: Case) -> None:
    """All answers are changed, and blanks stand behind the second line."""
    smuggle(random_journal(case), HIDES["behind blanks"])


def _line_after_pause(case: Case) -> None:
    """A line is made anew that came after the pause of a session whose anchors are of the pause and of the end."""
    path = case.journals()[1]
    lines = read_lines(path)
    forge(case.root, path, case.choose("line", range(_places(lines, "resumed")[0] + 1, len(lines) + 1)))


def _first_session(case: Case) -> None:
    """Nothing is forged: the first session of a study has begun, and has not ended."""
    case.study.run(case.study.header("01", case.study.tasks[0].tasks[0]))
    path = first_journal(case)
    write_chain(path, read_lines(path)[:-1])


def _session_after_withdrawal(case: Case) -> None:
    """A session whose header names the line of the roster by which its participant had withdrawn."""
    case.study.run(case.study.header("03", case.study.tasks[2].tasks[0]))
    known = Roster.load(roster(case))
    known.withdraw("03", REASON)
    path = case.journals()[2]
    write_chain(path, _changed_entry(read_lines(path), 0, roster_sha256=known.lines.end.last))


def _session_without_consent(case: Case) -> None:
    enrolling.enrol(case.study.file, "04", None, root=case.root, seed=None)
    case.study.run(case.study.header("04", case.study.tasks[3].tasks[0]))


def _session_before_a_place_was_taken(case: Case) -> None:
    """The fourth participant's session began under the third line of the roster."""
    path = case.journals()[2]
    under = chain.read(roster(case), DatasetError).links[2].sha256
    write_chain(path, _changed_entry(read_lines(path), 0, roster_sha256=under))


def _empty(case: Case) -> None:
    """A journal is emptied, and its head deleted."""
    path = random_journal(case)
    path.write_bytes(b"")
    chain.head_path(path).unlink()


FORGERIES = (
    Forgery("journal: a line deleted", JOURNALED, _damage(random_journal, _without_line)),
    Forgery("journal: a line doubled", JOURNALED, _damage(random_journal, _doubled_line)),
    Forgery("journal: a line that is no JSON", JOURNALED, _damage(random_journal, _broken_line)),
    Forgery("journal: the last lines cut off", JOURNALED, _damage(random_journal, _last_lines_cut)),
    Forgery("journal: the last lines cut off, its head made anew", JOURNALED, last_lines_cut(random_journal)),
    *(Forgery(f"journal: its head {name}", JOURNALED, _write_head(content)) for name, content in HEADS.items()),
    Forgery("journal: its head deleted", JOURNALED, delete(lambda case: chain.head_path(random_journal(case)))),
    Forgery("journal: a folder in its place", JOURNALED, make_folder(random_journal)),
    Forgery("journal: a torn last line", JOURNALED, append_bytes(random_journal, b'{"n": 99')),
    Forgery("journal: emptied, its head deleted", ("pairs", "study"), _empty),
    Forgery("roster: a line deleted", STUDIES, _damage(roster, _without_line)),
    Forgery("roster: the last lines cut off, its head made anew", STUDIES, last_lines_cut(roster)),
    Forgery("roster: a torn last line", STUDIES, append_bytes(roster, b'{"n": 99')),
    *(Forgery(f"journal anew: {name}", bases, _anew(random_journal, how)) for name, bases, how in JOURNALS),
    *(
        Forgery(f"roster anew: {name}", ("study",), _anew(roster, _with_entries(more)))
        for name, more in ROSTERS.items()
    ),
    Forgery("an answer and its table anew", JOURNALED, in_turn(_anew(random_journal, _other_answer), _build)),
    Forgery("a journal's line anew", JOURNALED, forge_line(random_journal)),
    Forgery("a roster's line anew", ("study", "pilot"), forge_line(roster)),
    Forgery(
        "answers anew, blanks behind a line, with a register", ("anchored", "pairs"), in_turn(_smuggle, ask_register)
    ),
    Forgery("a line after the pause anew", ("visits",), _line_after_pause),
    Forgery("a first session under way", ("new",), _first_session),
    Forgery("a session after the withdrawal", ("study",), _session_after_withdrawal),
    Forgery("a session without consent", ("study",), _session_without_consent),
    Forgery("a session before a place was taken", ("people",), _session_before_a_place_was_taken),
    Forgery("a withdrawal's file deleted", ("people",), delete(lambda case: storage.withdrawal_path(case.root, "03"))),
    Forgery(
        "a withdrawal cut off from its journal",
        ("people",),
        _anew(lambda case: case.journals()[1], lambda _, lines: lines[:-1]),
    ),
)
