"""Ctrl-C at any moment is one line and exit code 130, whatever is imported or done; and what is never imported."""

from __future__ import annotations

import builtins
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from palpate.experiment import __main__


def interrupt_import_of(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C the next time that a module is imported."""
    monkeypatch.delitem(sys.modules, name, raising=False)
    real = builtins.__import__

    def importing(wanted: str, *rest: Any, **named: Any) -> object:
        if wanted == name:
            raise KeyboardInterrupt
        return real(wanted, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", importing)


@pytest.mark.parametrize(
    ("module", "arguments"),
    [
        ("palpate.experiment.cli.app", ["check", "--help"]),
        ("palpate.experiment.rehearsal.kinds.footstep", ["record", "PROTOCOL", "--simulated", "--out", "OUT"]),
        ("palpate.analysis.validation", ["validate", "OUT"]),
        ("palpate.experiment.protocol", ["check", "PROTOCOL"]),
    ],
)
def test_an_interrupt_while_modules_load_is_one_line(
    tmp_path: Path,
    repository_root: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    module: str,
    arguments: list[str],
) -> None:
    paths = {"PROTOCOL": str(repository_root / "protocols" / "okamoto2012.toml"), "OUT": str(tmp_path / "set")}
    monkeypatch.setattr("sys.argv", ["palpate", *(paths.get(one, one) for one in arguments)])
    interrupt_import_of(module, monkeypatch)
    with pytest.raises(SystemExit) as end:
        __main__.main()
    assert end.value.code == 130
    (line,) = capsys.readouterr().err.splitlines()
    told = r"palpate: (the recording was )?interrupted; run the same command to continue( it| or to begin again)"
    assert re.fullmatch(told, line)
    assert not any(tmp_path.iterdir())


def test_an_interrupt_in_code_made_from_text_ends_with_the_code_too(repository_root: Path) -> None:
    """Data classes are such code. Python remembers that it was interrupted there, and ends with the signal."""
    code = """
import sys
from palpate.experiment import __main__
from palpate.experiment.cli import app
sys.argv = ["palpate", "check"]
app.main = lambda: exec("raise KeyboardInterrupt")
__main__.main()
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=repository_root, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr.count("\n")) == (130, 1)


def test_an_interrupt_while_a_model_is_made_is_told_as_one(repository_root: Path) -> None:
    """The maker of models is told of it in the middle of a class, and raises an error of its own."""
    code = """
import sys
from palpate.experiment import __main__
from palpate.experiment.cli import app
sys.argv = ["palpate", "check"]
class Interrupting:
    def __repr__(self):
        raise KeyboardInterrupt
def main():
    from pydantic_core import SchemaValidator, core_schema
    SchemaValidator(core_schema.literal_schema([Interrupting()]))
app.app = main
__main__.main()
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=repository_root, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr.count("\n")) == (130, 1), done.stderr


def test_an_interrupt_while_an_extension_loads_is_told_as_one(repository_root: Path) -> None:
    """What C++ does with an exception in its initialisation: an ImportError, with the interrupt as its cause."""
    code = """
import sys
from palpate.experiment import __main__
from palpate.experiment.cli import app
sys.argv = ["palpate", "check"]
def main():
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt as interrupt:
        raise ImportError("initialization failed") from interrupt
app.app = main
__main__.main()
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=repository_root, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr.count("\n")) == (130, 1), done.stderr


def test_an_interrupt_while_the_command_line_makes_a_class_is_told_as_one(repository_root: Path) -> None:
    """What Python does with an exception while a class is made: a RuntimeError, with the interrupt as its cause."""
    code = """
import sys
from palpate.experiment import __main__
class Interrupting:
    def __set_name__(self, owner, name):
        raise KeyboardInterrupt
class Finder:
    def find_spec(self, name, *rest):
        if name == "palpate.experiment.cli.app":
            type("Command", (), {"one": Interrupting()})
sys.meta_path.insert(0, Finder())
sys.argv = ["palpate", "check"]
__main__.main()
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=repository_root, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr.count("\n")) == (130, 1), done.stderr


def test_an_interrupt_in_a_callback_is_not_lost(repository_root: Path) -> None:
    """Importing ends in such callbacks, from which nothing can be raised: the command went on to its end."""
    code = """
import signal, sys, time, weakref
from palpate.experiment import __main__
from palpate.experiment.cli import app
sys.argv = ["palpate", "check"]
class Lock: pass
def main():
    lock = Lock()
    kept = weakref.ref(lock, lambda _: signal.raise_signal(signal.SIGINT))
    del lock
    time.sleep(60)
app.main = main
__main__.main()
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=repository_root, capture_output=True, text=True, check=False, timeout=50
    )
    assert (done.returncode, done.stderr.count("\n")) == (130, 1), done.stderr


def test_an_interrupt_after_the_last_line_changes_no_exit_code(repository_root: Path) -> None:
    code = """
import atexit, signal, sys
from palpate.experiment import __main__
# Runs after what the command has Python do at its end, and long after its last line.
atexit.register(signal.raise_signal, signal.SIGINT)
sys.argv = ["palpate", "--help"]
__main__.main()
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=repository_root, capture_output=True, text=True, check=False, timeout=50
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(("raised", "code"), [("KeyboardInterrupt", 130), ("PalpateError", 2), ("OSError", 2)])
def test_a_closed_standard_error_changes_no_exit_code(repository_root: Path, raised: str, code: int) -> None:
    """Each write to this device fails, as one to a terminal that was closed does."""
    source = f"""
import sys
from palpate.experiment import __main__
from palpate.experiment.cli import app
from palpate.experiment.errors import PalpateError
sys.argv = ["palpate", "check"]
def fails():
    raise {raised}("any")
app.app = fails
__main__.main()
"""
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        done = subprocess.run([sys.executable, "-c", source], cwd=repository_root, stderr=full, check=False)
    assert done.returncode == code


def test_other_ends_are_left_alone(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, code in ((["--version"], 0), (["no-such-command"], 2), (["check", "no-such-file.toml"], 2)):
        monkeypatch.setattr("sys.argv", ["palpate", *arguments])
        with pytest.raises(SystemExit) as end:
            __main__.main()
        assert (end.value.code or 0) == code
    assert "interrupted" not in capsys.readouterr().err


@pytest.mark.parametrize(("closed", "code"), [(">&-", 2), ("2>&-", 0)])
def test_a_closed_output_is_told_in_words_and_a_closed_error_stream_changes_nothing(
    repository_root: Path, closed: str, code: int
) -> None:
    command = f"{sys.executable} -m palpate.experiment check okamoto2012 {closed}"
    done = subprocess.run(["sh", "-c", command], cwd=repository_root, capture_output=True, text=True, check=False)
    assert done.returncode == code
    said = "palpate: standard output is closed; open it, or redirect it to /dev/null\n"
    assert done.stderr == (said if code else "")


def test_letters_that_a_code_page_lacks_leave_as_their_codes(tmp_path: Path, repository_root: Path) -> None:
    """A pipe on Windows has a code page; a title there may be in another alphabet."""
    protocol = tmp_path / "study.toml"
    text = (repository_root / "protocols" / "okamoto2012.toml").read_text("utf-8")
    protocol.write_text(re.sub('(?m)^title = ".*"$', 'title = "Fußtritte 触覚"', text, count=1), "utf-8")
    command = [sys.executable, "-m", "palpate.experiment", "check", str(protocol)]
    environment = {**os.environ, "PYTHONIOENCODING": "cp1252", "PYTHONUTF8": "0"}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (0, b"")
    assert "Fußtritte \\u89e6\\u899a" in done.stdout.decode("cp1252")


def test_pandas_loads_nothing_that_a_command_never_computes_with(tmp_path: Path) -> None:
    code = (
        "import sys; from palpate.experiment.__main__ import main\n"
        "sys.argv = ['palpate', '--help']; main(); import pandas\n"
        "sys.exit(sorted({'pyarrow.lib', 'numexpr'} & {name for name, module in sys.modules.items() if module}) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
