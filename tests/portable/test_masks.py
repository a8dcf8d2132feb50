"""The masks themselves: what is planted in palpate fails behind them, and the same passes in anybody else's module."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.portable import masks

BOTH = {
    "a folder of Linux": ("open('/proc/self/stat').close()", "FileNotFoundError"),
    "its file by pathlib": ("from pathlib import Path; assert Path('/proc/self/stat').exists()", "AssertionError"),
    "sys.platform": ("import sys; assert sys.platform == 'linux'", "AssertionError"),
    "a scheduler": ("import os; os.sched_getaffinity(0)", "AttributeError"),
    "posix_fallocate": ("from os import posix_fallocate", "ImportError"),
    "epoll": ("import select; select.epoll().close()", "AttributeError"),
}

PLANTED: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "windows": BOTH
    | {
        "fcntl": ("import fcntl", "ModuleNotFoundError"),
        "a name of termios": ("from termios import tcgetattr", "ModuleNotFoundError"),
        "pty by name": ("from importlib import import_module; import_module('pty')", "ModuleNotFoundError"),
        "os by name": ("import importlib; importlib.import_module('os').getuid()", "AttributeError"),
        "termios if there": ("from importlib.util import find_spec; assert find_spec('termios')", "AssertionError"),
        "the same of importlib": ("import importlib.util; assert importlib.util.find_spec('pty')", "AssertionError"),
        "fork": ("import os; os.fork", "AttributeError"),
        "os.name": ("import os; assert os.name == 'posix'", "AssertionError"),
        "SIGHUP": ("import signal; signal.SIGHUP", "AttributeError"),
        "a mask of signals": ("import signal; signal.pthread_sigmask(signal.SIG_BLOCK, [])", "AttributeError"),
        "AF_UNIX": ("import socket; socket.socket(socket.AF_UNIX).close()", "AttributeError"),
        "poll": ("import select; select.poll()", "AttributeError"),
        "select on a pipe": ("import os, select; select.select(os.pipe()[:1], [], [], 0)", "OSError"),
        "a selector": ("import selectors as s; assert s.DefaultSelector is s.EpollSelector", "AttributeError"),
        "a clock of the system": ("import time; time.clock_gettime(time.CLOCK_MONOTONIC)", "AttributeError"),
        "shared memory of mmap": ("from mmap import MAP_SHARED", "ImportError"),
        "processes by fork": ("import multiprocessing as m; m.get_context('fork')", "ValueError"),
        "the program's own library": ("import ctypes; ctypes.CDLL(None)", "TypeError"),
        "a descriptor for a process": ("from subprocess import run; run(['true'], pass_fds=[1])", "AssertionError"),
        "a call before a process": ("from subprocess import run; run(['true'], preexec_fn=int)", "ValueError"),
        "a signal for a process": (
            "import subprocess as s; p = s.Popen(['cat'], stdin=s.PIPE); p.send_signal(2) or p.communicate()",
            "ValueError",
        ),
        "a socket for a process": (
            "import socket, subprocess as s; a, b = socket.socketpair(); s.run(['true'], stdin=b.fileno())",
            "OSError",
        ),
        "text of a process": (
            "import subprocess as s; assert len(s.check_output(['printf', r'\\303\\251'], text=True)) == 1",
            "AssertionError",
        ),
        "replacing an open file": ("a.write_text(''); b.write_text(''); f = b.open(); a.replace(b)", "PermissionError"),
        "moving an open file": ("a.write_text(''); f = a.open(); a.replace(b)", "PermissionError"),
        "moving a folder of one": ("d.mkdir(); f = (d / 'f').open('w'); d.replace(b)", "PermissionError"),
        "deleting an open file": ("f = a.open('w'); a.unlink()", "PermissionError"),
        "deleting a folder of one": (
            "import shutil; d.mkdir(); f = (d / 'f').open('w'); shutil.rmtree(d)",
            "PermissionError",
        ),
        "a temporary folder of one": (
            "import tempfile as t; d = t.TemporaryDirectory(); f = open(d.name + '/f', 'w')\n"
            "try: d.cleanup()\nexcept OSError: 1 / 0",
            "ZeroDivisionError",
        ),
        "renaming onto a file": ("a.write_text(''); b.write_text(''); a.rename(b)", "FileExistsError"),
        "replacing a folder": ("d.mkdir(); b.mkdir(); d.replace(b)", "PermissionError"),
        "deleting what is read only": ("a.write_text(''); a.chmod(0o444); a.unlink()", "PermissionError"),
        "modes": ("a.write_text(''); a.chmod(0o600); assert a.stat().st_mode & 0o777 == 0o600", "AssertionError"),
        "opening a folder": ("import os; d.mkdir(); os.close(os.open(d, os.O_RDONLY))", "PermissionError"),
        "reading a folder": ("d.mkdir(); e = None\ntry: d.open()\nexcept IsADirectoryError: pass", "PermissionError"),
        "a link": ("a.symlink_to(b)", "OSError"),
        "a file named as a device": ("d.mkdir(); (d / 'aux.toml').write_text('')", "OSError"),
        "a folder named as a device": ("d.mkdir(); (d / 'CON').mkdir()", "OSError"),
        "a forbidden character": ("d.mkdir(); a.write_text(''); a.replace(d / 'a:b')", "OSError"),
        "text in the code page": ("a.write_text('é'); assert len(a.read_bytes()) == 2", "AssertionError"),
        "ends of lines": ("a.write_text('\\n', 'utf-8'); assert len(a.read_bytes()) == 1", "AssertionError"),
        "syncing what is read": ("import os; a.write_text(''); os.fsync(a.open())", "OSError"),
    },
    "macos": BOTH
    | {
        "real-time signals": ("import signal; signal.SIGRTMIN", "AttributeError"),
        "an abstract socket": ("import socket as s; s.socket(s.AF_UNIX).bind('\\0palpate')", "FileNotFoundError"),
        "a long path of a socket": (
            "import socket as s; s.socket(s.AF_UNIX).bind(__name__.ljust(105, '_'))",
            "OSError",
        ),
        "a limit of niceness": ("import resource; resource.RLIMIT_NICE", "AttributeError"),
        "the clock of suspended time": ("import time; time.clock_gettime(time.CLOCK_BOOTTIME)", "AttributeError"),
        "flock": ("import fcntl; fcntl.flock", ""),
        "fork": ("import os; os.fork", ""),
        "renaming onto a file": ("a.write_text(''); b.write_text(''); a.rename(b)", ""),
    },
}
"""For each system what is planted, and how it fails in palpate: not at all where that is empty."""

PREAMBLE = """
from pathlib import Path
here = Path(__file__).parent / __name__
here.mkdir()
a, b, d = here / "a", here / "b", here / "d"
"""

IMPORTED = """
import importlib, json, sys
folder, package, *names = sys.argv[1:]
sys.path.append(folder)
importlib.import_module(package).__path__.append(folder)
ended = []
for before in ("", package + "."):
    ended.append([])
    for name in names:
        try:
            importlib.import_module(before + name)
            ended[-1].append("")
        except BaseException as error:
            ended[-1].append(type(error).__name__)
print(json.dumps(ended))
"""
"""Imports modules of a folder, first as anybody's, then as those of a package, and prints how each failed."""


def python(system: str, home: Path, *arguments: str, check: bool = True) -> subprocess.CompletedProcess[str]:
    """Run Python behind a mask."""
    environment = masks.environment(system, home) | {"PYTHONSAFEPATH": "1"}
    return subprocess.run(
        [sys.executable, *arguments], env=environment, cwd=home, capture_output=True, encoding="utf-8", check=check
    )


@pytest.mark.parametrize("system", PLANTED)
def test_what_is_planted_fails_in_palpate_and_in_nobody_elses_module(system: str, tmp_path: Path) -> None:
    names = [f"planted_{number}" for number in range(len(PLANTED[system]))]
    for name, (code, _) in zip(names, PLANTED[system].values(), strict=True):
        (tmp_path / f"{name}.py").write_text(PREAMBLE + code, "utf-8")
    done = python(system, tmp_path, "-c", IMPORTED, str(tmp_path), "palpate.experiment", *names)
    others, ours = ([*zip(PLANTED[system], ends, strict=True)] for ends in json.loads(done.stdout))
    assert [(what, end) for what, end in others if end] == []
    assert ours == [(what, end) for what, (_, end) in PLANTED[system].items()]


STARTS = """
import multiprocessing, subprocess, sys
platform = "__import__('{module}').experiment.storage.sys.platform"
subprocess.run([sys.executable, "-P", "-c", f"print({platform})"])
with multiprocessing.get_context("spawn").Pool(1) as pool:
    print(pool.apply(eval, [platform]))
"""


@pytest.mark.parametrize(("system", "platform"), [("windows", "win32"), ("macos", "darwin")])
def test_what_a_process_starts_wears_the_mask(system: str, platform: str, tmp_path: Path) -> None:
    done = python(system, tmp_path, "-c", STARTS.replace("{module}", "palpate.experiment.storage"))
    assert done.stdout.split() == [platform, platform]


@pytest.mark.parametrize(
    ("system", "code", "printed"),
    [
        ("windows", "import os; print(os.name)", "posix"),
        ("windows", "import palpate.experiment.errors, os; print(os.name)", "nt"),
        ("windows", "import palpate.experiment.errors, multiprocessing as m; print(m.get_start_method())", "spawn"),
        ("macos", "import palpate.experiment.errors, multiprocessing as m; print(m.get_start_method())", "spawn"),
    ],
)
def test_a_main_module_of_palpate_wears_the_mask(system: str, code: str, printed: str, tmp_path: Path) -> None:
    assert python(system, tmp_path, "-c", code).stdout.strip() == printed


def test_every_signal_ends_a_process_on_windows(tmp_path: Path) -> None:
    code = "import palpate.experiment.errors, os, signal; signal.signal(2, signal.SIG_IGN); os.kill(os.getpid(), 2)"
    assert python("windows", tmp_path, "-c", code, check=False).returncode == 2


def test_redirected_output_is_in_the_code_page_on_windows(tmp_path: Path) -> None:
    code = "import sys; print(sys.stdout.encoding)"
    assert python("windows", tmp_path, "-c", code).stdout.strip() == "cp1252"
