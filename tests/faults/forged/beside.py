"""Forgeries of what stands beside the journals: protocol, seal, plan, rigs, raw frames and recordings."""

from __future__ import annotations

import os
import re
from datetime import date
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.approval import sealing
from tests.faults.forged.case import (
    Act,
    Case,
    Forgery,
    append_bytes,
    ask_register,
    delete,
    first_journal,
    in_turn,
    inside,
    make_folder,
    plan,
    protocol,
    replace_text,
    rig,
    seal,
    write,
)
from tests.faults.forged.studies import read_lines, write_chain

SEALED = ("study", "pairs", "anchored", "visits")
FOOTSTEPS = ("study", "visits", "people", "rehearsal")
PLANNED = ("rehearsed pairs", "practice", "rehearsal")


def _other_version(case: Case) -> Path:
    """Write a version of the protocol with many other texts, and a seal of its own; return it."""
    version = case.outside("version.toml")
    text = protocol(case).read_text("utf-8")
    version.write_text(
        re.sub(r'\b(title|description|reason|question|criterion) = "(?!")', r'\1 = "More: ', text), "utf-8"
    )
    loaded = files.load(version)
    sealing.write(
        version,
        loaded,
        approval_number="18",
        board=loaded.ethics.board,
        approved_on=date(2001, 1, 1),
        expires_on=date(2099, 1, 1),
    )
    return version


def _protocol_of_other_version(case: Case) -> None:
    protocol(case).write_bytes(_other_version(case).read_bytes())


def _seal_of_other_version(case: Case) -> None:
    seal(case).write_bytes(approval.seal_path(_other_version(case)).read_bytes())


def _seal_without_form(case: Case) -> None:
    """A seal of another version that does not hold the form that was approved, as an older palpate wrote it."""
    _seal_of_other_version(case)
    lines = seal(case).read_text("utf-8").splitlines(keepends=True)
    seal(case).write_text("".join(line for line in lines if not line.startswith("protocol = ")), "utf-8")


def _other_digit(case: Case) -> None:
    """A digit of the hash in the seal is another."""
    text = seal(case).read_text("utf-8")
    seal(case).write_text(re.sub(r'(_sha256 = ")(.)', lambda one: one[1] + "01"[one[2] == "0"], text), "utf-8")


def _make_pipe(case: Case) -> None:
    protocol(case).unlink()
    os.mkfifo(protocol(case))


def _make_large(case: Case) -> None:
    """A journal of 10 GB without a byte on disk."""
    os.truncate(first_journal(case), 10 * 2**30)


def _response(case: Case) -> Path:
    return rig(case).with_name("rehearsal-response.csv")


def _foot(case: Case) -> Path:
    return storage.foot_path(first_journal(case))


def _foot_of_open_session(case: Case) -> Path:
    return storage.foot_path(case.journals()[3])


def _driver(case: Case) -> Path:
    return rig(case).with_name("own.py")


def _with_driver(then: Act) -> Act:
    """A session was run on a rig with a driver of its own beside the rig file; then something happens to it."""

    def act(case: Case) -> None:
        path = first_journal(case)
        _driver(case).write_text("class Tracker: ...\n", "utf-8")
        replace_text(rig, "[tracker]\n", '[tracker]\ndriver = "own:Tracker"\n')(case)
        (t_ns, header), *rest = read_lines(path)
        write_chain(path, [(t_ns, {**header, "rig_sha256": rigs.sha256(rigs.load(rig(case)))}), *rest])
        then(case)

    return act


def _manifest(case: Case) -> Path:
    return case.root / storage.RECORDINGS / "manifest.toml"


def _random_take(case: Case) -> Path:
    return case.choose("take", sorted(_manifest(case).parent.glob("*.wav")))


TEMPORARY = inside("sourcedata", f".palpate-{'a' * 16}")

FORGERIES = (
    Forgery("no protocol", (*SEALED, *PLANNED), delete(protocol)),
    Forgery("a folder in the protocol's place", SEALED, make_folder(protocol)),
    Forgery("a pipe in the protocol's place", SEALED, _make_pipe),
    Forgery("a protocol that is no TOML", SEALED, write(protocol, "study =\n")),
    Forgery("a protocol that is not UTF-8", SEALED, append_bytes(protocol, b"# \xff\n")),
    Forgery("a protocol of format 1", SEALED, replace_text(protocol, "format = ", "format = 1  # not ")),
    Forgery("a protocol with a key more", SEALED, replace_text(protocol, "format = ", 'colour = "red"\nformat = ')),
    Forgery("a protocol with a comment more", (*SEALED, *PLANNED), append_bytes(protocol, b"# One more.\n")),
    Forgery("a protocol with many other texts", SEALED, _protocol_of_other_version),
    Forgery("another protocol in a rehearsal", PLANNED, replace_text(protocol, 'title = "', 'title = "More: ')),
    Forgery("a seal of another version", SEALED, _seal_of_other_version),
    Forgery("a seal of another version, without its form", SEALED, _seal_without_form),
    Forgery("a seal with another digit in its hash", SEALED, _other_digit),
    Forgery("a seal of another board", SEALED, replace_text(seal, 'board = "', 'board = "Another ')),
    Forgery("a seal that ended before it began", SEALED, replace_text(seal, "2099-", "2000-")),
    Forgery(
        "another approval number, with a register",
        ("anchored", "pairs"),
        in_turn(replace_text(seal, '"17"', '"18"'), ask_register),
    ),
    Forgery("no seal, with a register", ("anchored", "pairs"), in_turn(delete(seal), ask_register)),
    Forgery("no plan", PLANNED, delete(plan)),
    Forgery("a plan that is no plan", PLANNED, write(plan, "1\n")),
    Forgery("a rig with a key more", FOOTSTEPS, replace_text(rig, "format = ", "more = 1\nformat = ")),
    Forgery("a rig at another port", FOOTSTEPS, replace_text(rig, 'port = "rehearsal"', 'port = "/dev/ttyACM0"')),
    Forgery("a rig with another driver", ("study", "pairs"), _with_driver(append_bytes(_driver, b"# More.\n"))),
    Forgery("no response table", (*FOOTSTEPS, "pairs"), delete(_response)),
    Forgery("another response table", FOOTSTEPS, append_bytes(_response, b"999,1,1\n")),
    Forgery("a journal of 10 GB", ("pairs", "study"), _make_large),
    Forgery("frames behind the last step", FOOTSTEPS, append_bytes(_foot, b"x" * 7)),
    Forgery("frames behind the last step so far", ("visits",), append_bytes(_foot_of_open_session, b"x" * 7)),
    Forgery("another take", ("rehearsal",), append_bytes(_random_take, b"\0")),
    Forgery("a take deleted", ("rehearsal",), delete(_random_take)),
    Forgery("no manifest of recordings", ("rehearsal",), delete(_manifest)),
    Forgery("a manifest that is no TOML", ("rehearsal",), write(_manifest, "takes =\n")),
    Forgery("another manifest", ("rehearsal",), append_bytes(_manifest, b"# More.\n")),
    Forgery("another file of lines", ("study", "practice"), write(inside("sourcedata", "notes.jsonl"), "{}\n")),
    Forgery("a temporary file", ("study", "rehearsal", "pairs"), write(TEMPORARY)),
    Forgery("results of an analysis", ("study", "rehearsal", "imported"), write(inside("derivatives", "a.csv"))),
    Forgery("voices of an erased participant", ("people",), write(inside("sourcedata", "sub-05", "voices", "a.wav"))),
)
