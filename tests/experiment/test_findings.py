"""Findings, the errors that carry them, and commands as a shell reads them."""

import pickle
import shlex
from pathlib import Path

import pytest

from palpate.experiment.errors import DatasetError, PalpateError, ProtocolError, RigError, mismatch
from palpate.experiment.findings import Finding, Remedy, windows_command, wrapped

FILE = Path("/data/study/participants.tsv")
COMMAND = ("palpate", "build", "/data/my study")


def test_the_parts_of_an_error_give_its_sentence() -> None:
    error = DatasetError(FILE, "got 3", "mend it", allowed="1 or 2", field="age", line=12)
    parts = ("line 12: age: got 3", "allowed: 1 or 2", "mend it")
    assert str(error) == f"{FILE}: {'; '.join(parts)}"
    assert error.finding.sentence(FILE.parent) == f"participants.tsv: {'; '.join(parts)}"
    assert error.findings == (error.finding,)
    assert error.finding.verdict == "refuses"


def test_one_argument_alone_is_what_was_found() -> None:
    error = PalpateError("it broke")
    assert (error.finding.what, error.finding.where, str(error)) == ("it broke", "", "it broke")


def test_a_file_outside_of_the_dataset_and_the_dataset_itself_keep_their_paths() -> None:
    for where in (FILE, FILE.parent, "--number"):
        assert Finding("is missing", where).place(FILE.parent / "sub") == str(where)
    assert Finding("is missing", FILE.parent).place(FILE.parent) == str(FILE.parent)


def test_a_file_s_error_sums_up_its_findings_and_passes_between_processes() -> None:
    problems = [mismatch("tasks[0].id", 3, "nothing", "a label"), mismatch("seed", None, "'x'", "a number")]
    error = ProtocolError.in_file(FILE, problems)
    assert str(error).splitlines() == [
        f"{FILE}: 2 errors",
        "  line 3: tasks[0].id: " + "; ".join(("got nothing", "allowed: a label")),
        "  seed: " + "; ".join(("got 'x'", "allowed: a number")),
    ]
    assert [(one.where, one.field, one.got) for one in error.findings] == [
        (FILE, "tasks[0].id", "nothing"),
        (FILE, "seed", "'x'"),
    ]
    again = pickle.loads(pickle.dumps(error))
    as_rig = RigError.saying(error)
    for other in (again, as_rig):
        assert (str(other), other.finding, other.findings) == (str(error), error.finding, error.findings)
    assert (type(again), type(as_rig)) == (ProtocolError, RigError)


def test_a_remedy_shows_its_command_where_its_words_say_so_or_behind_them() -> None:
    shown = shlex.join(COMMAND)
    assert str(Remedy("make it again", COMMAND)) == f"{'make it again'} ({shown})"
    assert str(Remedy("run {}, then", COMMAND)) == f"run {shown}, then"


def test_no_line_ends_inside_of_a_command() -> None:
    remedy, shown = Remedy("make it again", COMMAND), shlex.join(COMMAND)
    finding = Finding("is missing", FILE, remedy=remedy)
    for lines in (wrapped(f"{remedy}", remedy, 20, ("> ", "  ")), finding.lines(20, ("> ", "  "), FILE.parent)):
        assert [line.strip() for line in lines if "palpate" in line] == [f"({shown})"]
        assert (lines[0][:2], {line[:2] for line in lines[1:]}) == ("> ", {"  "})
    assert wrapped("one two", "", 5, ("", "")) == ["one", "two"]


@pytest.mark.parametrize(
    ("argument", "read"),
    [
        (r"C:\Users\me", r"C:\Users\me"),
        (r"C:\Users\my name", r'"C:\Users\my name"'),
        ("a folder\\", '"a folder\\\\"'),
        ("", '""'),
        ("a;b", '"a;b"'),
        ("100%", "'100%'"),
        ("$it's", "'$it''s'"),
    ],
)
def test_windows_reads_an_argument_as_it_was(argument: str, read: str) -> None:
    assert windows_command(["palpate", argument]) == f"palpate {read}"
