"""A practice whose console is served, as on Windows by a port of this machine and as on macOS by a socket file."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from palpate.experiment import storage
from palpate.experiment.desk.console import transport
from palpate.experiment.desk.link import Line
from palpate.experiment.desk.link.wire import Stop
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Answer, Footer
from tests.experiment.protocol.small import SMALL
from tests.portable import masks
from tests.rig.visited import ME, PATIENCE_S, Desk

COMMAND = """
from palpate.experiment.__main__ import main
from palpate.experiment.rehearsal.kinds.footstep import participant
from tests.rig.laboratory import HURRIED
vars(participant).update(HURRIED)
main()
"""


class Served(Desk):
    """Somebody at the console of a session that wears a mask."""

    def serve(self, system: str) -> subprocess.Popen[bytes]:
        environment = masks.environment(system, self.folder)
        words = [*self.words, "--dataset", "data", "--session-at", str(self.socket)]
        with (self.folder / "log").open("wb") as log:
            command = [sys.executable, "-P", "-c", COMMAND, *words]
            process = subprocess.Popen(command, cwd=self.folder, env=environment, stdout=log, stderr=log)
        ends_s = time.monotonic() + PATIENCE_S
        while not transport.answers(self.socket):
            assert process.poll() is None, self.log
            assert time.monotonic() < ends_s
            time.sleep(0.05)
        self.there = Line(self.socket, ME)
        return process


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Served]:
    (tmp_path / "small.toml").write_text(re.sub("repetitions = [0-9]", "repetitions = 1", SMALL), "utf-8")
    with closing(Served(tmp_path, ("run", "small.toml", "--practice", "--task", "one"))) as one:
        yield one


@pytest.mark.parametrize("system", ["windows", "macos"])
def test_a_practice_is_keyed_at_a_served_console(desk: Served, system: str) -> None:
    with ExitStack() as opened:
        process = opened.enter_context(desk.serve(system))
        opened.callback(process.kill)
        assert desk.socket.is_socket() == (system == "macos")
        desk.visit(lambda view: view.trial == 2)
        assert desk.there is not None
        desk.there.send(Stop())
        ended = desk.visit().ended
        assert process.wait(PATIENCE_S) == 0
    assert ended is not None
    assert ended.exit_code == 0
    assert not desk.socket.exists()
    entries = journal.read(storage.journal_path(desk.root, "01", "one")).entries
    assert [entry.trial for entry in entries if isinstance(entry, Answer)] == [1]
    assert isinstance(entries[-1], Footer)
