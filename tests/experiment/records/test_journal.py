"""The journal against torn ends, changed bytes and second runners."""

from __future__ import annotations

import errno
import gc
import hashlib
import json
import os
import shutil
import sys
import tempfile
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from io import FileIO
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.experiment import storage
from palpate.experiment.errors import JournalError, OtherFormat, SessionLocked
from palpate.experiment.records import chain, journal, transcript
from palpate.experiment.records.entries import Answer, Entry, Footer, Note, Phase, Purpose, Shown
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.settings.characters import hidden
from tests.approved import Refuses
from tests.experiment.session.bench import HEADER

pytestmark = pytest.mark.fsync

ANSWER = Answer(trial=1, attempt=1, presented=("foil",), answered=None, key="n", response_time_s=0.25, confirmed_s=0.25)
ENTRIES: tuple[Entry, ...] = (
    HEADER,
    Phase(state="familiarising"),
    ANSWER,
    Footer(reason="complete", answered=1),
)


def write(path: Path, entries: tuple[Entry, ...] = ENTRIES) -> bytes:
    clock = ManualClock(10)
    opened = journal.Journal(path, clock, journal.Contents(()))
    for entry in entries:
        opened.append(entry)
        clock.sleep_ns(5)
    opened.close()
    return path.read_bytes()


def chained(path: Path, position: int, entry: bytes) -> None:
    """Put an entry into a journal as one more line, whatever it is, and chain every line behind it anew."""
    lines, last = list[bytes](), chain.GENESIS
    found = [(link.t_ns, link.json) for link in chain.read(path, JournalError).links]
    for number, (t_ns, what) in enumerate([*found[:position], (12, entry), *found[position:]]):
        lines.append(b'{"n":%d,"t_ns":%d,"prev":"%s","entry":%s}' % (number, t_ns, last.encode(), what))
        last = hashlib.sha256(lines[-1]).hexdigest()
    path.write_bytes(b"".join(line + b"\n" for line in lines))
    write_head(path)


def write_head(path: Path, behind: int = 0) -> None:
    """Write the head that a journal has, or had some lines ago."""
    lines = path.read_bytes().split(b"\n")[:-1]
    known = len(lines) - behind
    last = hashlib.sha256(lines[known - 1]).hexdigest() if known else chain.GENESIS
    chain.head_path(path).write_text(f"{known:012d} {last}\n")


def test_what_was_written_is_read_back(tmp_path: Path) -> None:
    write(tmp_path / "j")
    contents = journal.read(tmp_path / "j")
    assert contents.entries == ENTRIES
    assert [line.t_ns for line in contents.lines] == [10, 15, 20, 25]
    assert contents.torn == b""


@pytest.mark.parametrize("purpose", ["STUDY", "PILOT", "PRACTICE", "REHEARSAL"])
def test_an_entry_is_waited_for_unless_it_can_be_rehearsed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, purpose: Purpose
) -> None:
    synced: list[str] = []
    fsync = os.fsync

    def told(descriptor: int) -> None:
        fsync(descriptor)
        synced.append(Path(f"/proc/self/fd/{descriptor}").readlink().name)

    header = HEADER.model_copy(update={"purpose": purpose})
    opened = journal.Journal(tmp_path / "j.jsonl", ManualClock(0), journal.Contents(()))
    monkeypatch.setattr(os, "fsync", told)
    for entry in (header, *ENTRIES[1:]):
        synced.clear()
        opened.append(entry)
        assert synced == ([] if purpose == "REHEARSAL" else ["j.jsonl", "j.head"])
    assert journal.read(tmp_path / "j.jsonl").entries == (header, *ENTRIES[1:])
    synced.clear()
    opened.close()
    assert synced == (["j.jsonl", "j.head"] if purpose == "REHEARSAL" else [])


def test_what_was_read_holds_nothing_but_its_entries(tmp_path: Path, without_fsync: None) -> None:
    write(tmp_path / "j", (HEADER, *(ENTRIES[1:3] * 200)))
    entries = [link.entry for link in chain.read(tmp_path / "j", JournalError).links]

    def held(read: Callable[[], object]) -> int:
        read()  # What is made once is made here.
        tracemalloc.start()
        try:
            kept = read()
            gc.collect()
            return tracemalloc.get_traced_memory()[0] if kept else 0
        finally:
            tracemalloc.stop()

    reader = journal.reader(HEADER.task_kind)
    alone = held(lambda: [journal.Line(0, reader.validate_json(json.dumps(entry))) for entry in entries])
    assert held(lambda: journal.read(tmp_path / "j")) < 1.2 * alone


def test_a_journal_is_told_without_control_characters(tmp_path: Path, without_fsync: None) -> None:
    nasty = "a\x1b[2J\u202e\n     0.000 s  b"
    write(tmp_path / "j", (HEADER, Phase(state="paused", detail=nasty), Footer(reason="complete", answered=1)))
    with (tmp_path / "j").open("ab") as file:
        file.write(b'{"torn": "\x1b[2J')
    told = transcript.text(journal.read(tmp_path / "j"))
    assert not hidden(told, "\n")
    assert "paused a<U+001B>[2J<U+202E><U+000A>     0.000 s  b" in told


def test_each_line_carries_the_hash_of_the_one_before(tmp_path: Path) -> None:
    lines = write(tmp_path / "j").splitlines()
    previous = [hashlib.sha256(line).hexdigest() for line in lines]
    assert [json.loads(line)["prev"] for line in lines] == ["0" * 64, *previous[:-1]]


def test_every_truncation_keeps_the_whole_lines_and_can_be_continued(tmp_path: Path, without_fsync: None) -> None:
    data = write(tmp_path / "whole")
    path = tmp_path / "cut"
    for length in range(len(data) + 1):
        path.write_bytes(data[:length])
        write_head(path)
        contents = journal.read(path)
        kept = data[:length].count(b"\n")
        assert contents.entries == ENTRIES[:kept]
        assert len(contents.torn) == length - contents.end.size
        opened = journal.Journal(path, ManualClock(0), contents)
        opened.append(ANSWER if kept else HEADER)
        opened.close()
        assert journal.read(path).entries == (*ENTRIES[:kept], ANSWER if kept else HEADER)


@given(position=st.integers(min_value=0), bit=st.integers(min_value=0, max_value=7))
@settings(max_examples=150, deadline=None)
def test_no_flipped_bit_passes_unless_in_the_last_line(position: int, bit: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "j"
        data = bytearray(write(path))
        chain.head_path(path).unlink()
        last = data.rstrip(b"\n").rfind(b"\n") + 1
        data[position % last] ^= 1 << bit
        path.write_bytes(data)
        with pytest.raises(JournalError, match=r"line \d"):
            journal.read(path)


def test_a_missing_or_doubled_line_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "j"
    lines = write(path).splitlines(keepends=True)
    chain.head_path(path).unlink()
    for changed in ([lines[0], *lines[2:]], [*lines[:2], lines[1], *lines[2:]], lines[1:]):
        path.write_bytes(b"".join(changed))
        with pytest.raises(JournalError, match="restore it from a backup"):
            journal.read(path)


def test_a_broken_last_line_with_its_newline_is_refused(tmp_path: Path, refuses: Refuses) -> None:
    path = tmp_path / "j"
    data = write(path)
    chain.head_path(path).unlink()
    path.write_bytes(data[:-10] + b"\n")
    with refuses(JournalError):
        journal.read(path)


def test_an_end_that_was_cut_off_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "j"
    data = write(path)
    for length in range(len(data)):
        path.write_bytes(data[:length])
        with pytest.raises(
            JournalError, match=rf"truncated: it had 4 lines and now has {data[:length].count(10)}; copy"
        ):
            journal.read(path)
    path.write_bytes(data + b'{"n":4,"t_')
    assert journal.read(path).torn == b'{"n":4,"t_'


def test_a_head_behind_its_journal_is_a_kill_between_the_two(tmp_path: Path) -> None:
    path = tmp_path / "j"
    write(path, ENTRIES[:3])
    early = chain.head_path(path).read_bytes()
    assert early.startswith(b"000000000003 ")
    path.unlink()
    write(path)
    chain.head_path(path).write_bytes(early)
    assert journal.read(path).entries == ENTRIES
    for changed in (early[:20], early[:5], early[:-1], early[:13] + b"0" * 64 + early[-1:]):
        chain.head_path(path).write_bytes(changed)
        with pytest.raises(JournalError, match=r"restore .* from a backup"):
            journal.read(path)


@pytest.mark.parametrize("head", ["-3 abc", "3", "3 a b", "0x3 abc", f"{'9' * 5000} abc", "\u0663 abc", "nan abc"])
def test_a_head_that_was_never_written_so_is_refused(tmp_path: Path, head: str, refuses: Refuses) -> None:
    write(tmp_path / "j")
    chain.head_path(tmp_path / "j").write_text(head, "utf-8")
    with refuses(JournalError):
        journal.read(tmp_path / "j")


def test_more_lines_than_the_head_names_are_a_head_that_was_deleted_or_replaced(tmp_path: Path) -> None:
    path = tmp_path / "j"
    data = write(path)
    for lines in range(len(ENTRIES) + 1):
        path.write_bytes(b"".join(data.splitlines(keepends=True)[:lines]))
        for behind in range(lines + 1):
            write_head(path, behind)
            if behind == lines:
                chain.head_path(path).unlink()
            if behind < 2:
                assert len(journal.read(path).lines) == lines
                continue
            known = rf"j\.head states {lines - behind}" if behind < lines else r"no j\.head"
            with pytest.raises(
                JournalError, match=rf"got {lines} lines, but {known}; allowed: a j\.head that .*{lines}"
            ):
                journal.read(path)


def test_what_was_written_since_a_journal_was_read_is_never_cut_off(tmp_path: Path, refuses: Refuses) -> None:
    path = tmp_path / "j"
    write(path, ENTRIES[:2])
    before = journal.read(path)
    first = journal.Journal(path, ManualClock(0), before)
    first.append(ENTRIES[2])
    first.close()
    with refuses(SessionLocked):
        journal.Journal(path, ManualClock(0), before)
    assert len(journal.read(path).lines) == 3


@pytest.mark.parametrize("operation", ["write", "fsync", "_write_head"])
@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
def test_an_interrupt_in_the_middle_of_a_write_never_breaks_the_journal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, operation: str, after: bool
) -> None:
    path, header = tmp_path / "j", HEADER.model_copy(update={"purpose": "STUDY"})
    opened = journal.Journal(path, ManualClock(0), journal.Contents(()))
    opened.append(header)
    writer = opened._writer
    owner = {"fsync": os, "_write_head": writer}.get(operation, writer._file)
    real = getattr(owner, operation)

    def interrupted(*arguments: object) -> object:
        if after:
            real(*arguments)
        raise KeyboardInterrupt

    if owner is writer._file:
        monkeypatch.setattr(writer, "_file", InterruptedFile(writer._file, operation, interrupted))
    else:
        monkeypatch.setattr(owner, operation, interrupted)
    with pytest.raises(KeyboardInterrupt):
        opened.append(ANSWER)
    monkeypatch.undo()
    assert not opened.accepts
    opened.close()
    contents = journal.read(path)
    assert contents.entries in ((header,), (header, ANSWER))
    again = journal.Journal(path, ManualClock(0), contents)
    again.append(ENTRIES[3])
    again.close()
    assert journal.read(path).entries == (*contents.entries, ENTRIES[3])


class InterruptedFile:
    """A file of which one method is replaced."""

    def __init__(self, file: FileIO, name: str, method: Callable[..., object]) -> None:
        self._file = file
        setattr(self, name, method)

    def __getattr__(self, name: str) -> object:
        return getattr(self._file, name)


@pytest.mark.parametrize(("number", "maker"), [(None, "an unreleased"), (8, "an unreleased"), (11, "a newer")])
def test_a_journal_of_another_format_is_refused_in_words(tmp_path: Path, number: int | None, maker: str) -> None:
    path = tmp_path / "j"
    line = json.loads(write(path, ENTRIES[:1]))
    # Another form may have anything in it.
    line["entry"] |= {"format": number, "color": "red"}
    path.write_text(json.dumps(line, separators=(",", ":"), ensure_ascii=False) + "\n", "utf-8")
    chain.head_path(path).unlink()
    with pytest.raises(OtherFormat, match=rf"line 1: made by {maker} version of palpate \(palpate 0\)"):
        journal.read(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'{"n"', b'{ "n"'),
        (b'{"n"', b'{\r"n"'),
        (b'{"n"', b'{"entry":{"kind":"footer"},"n"'),
        (b'"entry":{', b'"entry":{"kind":"answer",'),
        (b'"n":1', b'"n":1.0'),
        (b"}}", b"}} "),
    ],
)
def test_a_line_that_holds_more_than_it_says_is_refused(
    tmp_path: Path, old: bytes, new: bytes, refuses: Refuses
) -> None:
    """JSON allows it, and another line could hide there."""
    path = tmp_path / "j"
    write(path, ENTRIES[:2])
    first, second, _ = path.read_bytes().split(b"\n")
    assert old in second
    path.write_bytes(first + b"\n" + second.replace(old, new, 1) + b"\n")
    chain.head_path(path).unlink()
    with refuses(JournalError):
        journal.read(path)


@pytest.mark.parametrize("more", [b'"\\ud800"', b'"\xed\xa0\x80"', b"1e999"])
def test_a_line_that_says_what_no_text_or_number_is_is_refused(tmp_path: Path, more: bytes, refuses: Refuses) -> None:
    path = tmp_path / "j"
    write(path, ENTRIES[:2])
    path.write_bytes(path.read_bytes().replace(b"}}\n", b',"more":%s}}\n' % more))
    chain.head_path(path).unlink()
    with refuses(JournalError):
        journal.read(path)


@pytest.mark.parametrize("moved", [False, True])
@pytest.mark.parametrize("what", ["journal", "head", "folder"])
def test_a_journal_that_goes_is_noticed_at_the_next_entry(
    tmp_path: Path, what: str, moved: bool, refuses: Refuses
) -> None:
    path = tmp_path / "sub-01" / "j"
    opened = journal.Journal(path, ManualClock(0), journal.Contents(()))
    opened.append(HEADER)
    gone = {"journal": path, "head": chain.head_path(path), "folder": path.parent}[what]
    if moved:
        gone.rename(tmp_path / "elsewhere")
    elif gone.is_dir():
        shutil.rmtree(gone)
    else:
        gone.unlink()
    if not moved and what != "folder":
        # Another file of its name is not the one that is being written.
        gone.touch()
    with refuses(JournalError):
        opened.append(ANSWER)
    opened.close()


def test_a_disk_that_is_full_leaves_whole_lines_and_takes_the_next_when_it_has_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuses: Refuses
) -> None:
    path = tmp_path / "j"
    opened = journal.Journal(path, ManualClock(0), journal.Contents(()))
    opened.append(HEADER)

    def full(content: memoryview) -> int:
        if len(content) < 20:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(content[: len(content) // 2])

    writer = opened._writer
    real = writer._file.write
    with monkeypatch.context() as patched:
        patched.setattr(writer, "_file", InterruptedFile(writer._file, "write", full))
        with refuses(JournalError):
            opened.append(ANSWER)
    assert opened.accepts
    assert journal.read(path).entries == (HEADER,)
    opened.append(ENTRIES[3])
    opened.close()
    assert journal.read(path).entries == (HEADER, ENTRIES[3])


def test_a_head_that_cannot_be_written_leaves_a_journal_that_can_be_continued(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuses: Refuses
) -> None:
    path = tmp_path / "j"
    opened = journal.Journal(path, ManualClock(0), journal.Contents(()))
    opened.append(HEADER)

    def failing() -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(opened._writer, "_write_head", failing)
    with refuses(JournalError):
        opened.append(ANSWER)
    assert not opened.accepts
    with refuses(JournalError):
        opened.append(ANSWER)
    opened.close()
    assert journal.read(path).entries == (HEADER, ANSWER)


def test_a_missing_journal_is_named(tmp_path: Path, refuses: Refuses) -> None:
    with refuses(JournalError):
        journal.read(tmp_path / "none")


def test_a_participant_is_held_by_one_runner(tmp_path: Path, refuses: Refuses) -> None:
    with (
        journal.locked(tmp_path, "01"),
        refuses(SessionLocked),
        journal.locked(tmp_path, "01"),
    ):
        pass
    with journal.locked(tmp_path, "01"):
        pass


@pytest.mark.skipif(not hasattr(os, "O_DIRECTORY"), reason="the system locks files alone")
def test_no_second_runner_is_let_in_by_removing_the_lock(tmp_path: Path, refuses: Refuses) -> None:
    with journal.locked(tmp_path, "01"):
        (tmp_path / ".sub-01.lock").unlink()
        with (
            refuses(SessionLocked),
            journal.locked(tmp_path, "01"),
        ):
            pass
    with journal.locked(tmp_path, "01"):
        pass


@pytest.mark.skipif(sys.platform == "win32", reason="the system has no such locks")
def test_a_journal_that_is_written_is_held(tmp_path: Path, refuses: Refuses) -> None:
    path = tmp_path / "j"
    opened = journal.Journal(path, ManualClock(0), journal.Contents(()))
    opened.append(HEADER)
    before = path.read_bytes()
    with refuses(SessionLocked):
        journal.Journal(path, ManualClock(0), journal.Contents(()))
    assert path.read_bytes() == before
    opened.close()
    journal.Journal(path, ManualClock(0), journal.read(path)).close()


OUT_OF_REACH: tuple[Entry, ...] = (
    Note(trial=2**63, text="a door"),
    Note(trial=10**5000, text="a door"),
    Note(trial=1, text="half a character: \ud800"),
    Shown(show="wait", text="", pace=None, since_ns=-(10**30)),
    ANSWER.model_copy(update={"response_time_s": float("nan")}),
    ANSWER.model_copy(update={"trial": "1"}),
    HEADER,
)


@pytest.mark.parametrize("entry", OUT_OF_REACH, ids=range(len(OUT_OF_REACH)))
def test_an_entry_that_cannot_be_read_again_is_refused_before_the_first_byte(tmp_path: Path, entry: Entry) -> None:
    path = tmp_path / "j"
    opened = journal.Journal(path, ManualClock(10), journal.Contents(()))
    opened.append(HEADER)
    before = path.read_bytes(), chain.head_path(path).read_bytes()
    with pytest.raises(JournalError, match="was not written"):
        opened.append(entry)
    assert (path.read_bytes(), chain.head_path(path).read_bytes()) == before
    opened.append(ANSWER)
    opened.close()
    assert journal.read(path).entries == (HEADER, ANSWER)


@given(st.one_of(st.none(), st.integers()), st.text(st.characters()), st.integers(), st.floats())
def test_any_entry_is_refused_or_reads_back_equal(trial: int | None, text: str, since_ns: int, time_s: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "j"
        opened = journal.Journal(path, ManualClock(10), journal.Contents(()))
        written: list[Entry] = [HEADER]
        opened.append(HEADER)
        answer = ANSWER.model_copy(update={"response_time_s": time_s})
        for entry in (
            Note(trial=trial, text=text),
            Shown(show="wait", text=text, pace=None, since_ns=since_ns),
            answer,
        ):
            with suppress(JournalError):
                opened.append(entry)
                written.append(entry)
        opened.close()
        assert journal.read(path).entries == tuple(written)


UNREADABLE = [
    b'{"kind":"note","trial":%d,"text":"a door"}' % 2**63,
    b'{"kind":"shown","show":"wait","text":"","pace":null,"since_ns":-%d}' % 10**30,
    b'{"kind":"note","trial":1,"text":"\\ud800"}',
    b'{"kind":"answer","trial":1,"attempt":NaN}',
    b'{"kind":"note","trial":1,"text":"\xff"}',
    b'{"kind":"rating","trial":1}',
    b'{"trial":1}',
    HEADER.model_dump_json().encode(),
]


@pytest.mark.parametrize("entry", UNREADABLE, ids=range(len(UNREADABLE)))
@pytest.mark.parametrize("position", [1, 3, 4])
def test_one_entry_that_cannot_be_read_hides_none_of_the_others(tmp_path: Path, entry: bytes, position: int) -> None:
    path = tmp_path / "j"
    write(path)
    chained(path, position, entry)
    contents = journal.read(path, strict=False)
    assert contents.entries == ENTRIES
    assert [(one.number, one.t_ns) for one in contents.unreadable] == [(position + 1, 12)]
    assert f"line {position + 1} CANNOT BE" in transcript.text(contents)
    with pytest.raises(JournalError, match=rf"line {position + 1} .* 1 no answer"):
        journal.read(path)


def test_what_was_changed_is_refused_also_where_an_entry_cannot_be_read(tmp_path: Path) -> None:
    path = tmp_path / "j"
    write(path)
    chained(path, 2, UNREADABLE[0])
    data, head = path.read_bytes(), chain.head_path(path).read_bytes()
    lines = data.splitlines(keepends=True)
    for changed in (
        data.replace(b"a door", b"a desk"),
        data.replace(b'"n":2,', b'"n":7,'),
        b"".join(lines[:2] + lines[3:]),
        b"".join(lines[:3]),
    ):
        path.write_bytes(changed)
        with pytest.raises(JournalError, match="backup"):
            journal.read(path, strict=False)
    chain.head_path(path).write_bytes(head)
    first = lines[0].replace(b'"order":', b'"order":NaN,"more":')
    path.write_bytes(first)
    write_head(path)
    with pytest.raises(JournalError, match="line 1 is"):
        journal.read(path, strict=False)


def test_no_line_makes_a_journal_larger_than_what_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "j"
    opened = journal.Journal(path, ManualClock(10), journal.Contents(()))
    opened.append(HEADER)
    monkeypatch.setattr(storage, "MOST", 2 * len(path.read_bytes()))
    with pytest.raises(JournalError, match="was not written"):
        for _ in range(100):
            opened.append(Note(trial=1, text="a door slammed"))
    opened.close()
    assert len(journal.read(path).entries) > 2
