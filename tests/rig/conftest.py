"""What several tests of real parts start from: a server, a line, a rehearsal."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from palpate.experiment.apparatus import rig
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.tracker.settings import TrackerRig
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.wires.serial_line import SerialLine
from tests.rig.laboratory import NOISE_MM
from tests.rig.rehearsed import rehearse
from tests.working_folder import LOG, WorkingFolder


@pytest.fixture
def line() -> Iterator[SerialLine]:
    with SerialLine() as laid:
        yield laid


@pytest.fixture
def working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[WorkingFolder]:
    """The test's folder, with files that have names of modules; nothing that is started there imports them."""
    made = WorkingFolder(tmp_path)
    monkeypatch.setenv(LOG, str(made.log))
    yield made
    assert made.imported == []


@pytest.fixture(scope="module")
def settings() -> TrackerRig:
    """The tracker of the rehearsal's rig, as noisy as the tests' foot."""
    tracker = tracker_of(rig.load(shipped("rigs/rehearsal.toml")))
    return tracker.model_copy(update={"noise_mm": NOISE_MM})


@pytest.fixture(scope="session")
def one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rehearsal of one participant; only to be read."""
    return rehearse(tmp_path_factory.mktemp("one") / "rehearsal")


@pytest.fixture
def pulseaudio(tmp_path: Path) -> Iterator[tuple[str, dict[str, str]]]:
    """A PulseAudio of our own with a null sink at 48 kHz: the address of its raw port, and its clients' environment."""
    if shutil.which("pulseaudio") is None or shutil.which("parec") is None:
        pytest.skip("needs PulseAudio (packages pulseaudio, pulseaudio-utils)")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    runtime = tmp_path / "pulse"
    runtime.mkdir(mode=0o700)
    paths = ("HOME", "XDG_RUNTIME_DIR", "XDG_CONFIG_HOME", "PULSE_RUNTIME_PATH")
    environment = {**os.environ, **dict.fromkeys(paths, str(runtime)), "PULSE_SERVER": f"unix:{runtime}/native"}
    form = "rate=48000 format=float32le channels=1"
    # The sink takes back what it mixed ahead when a stream begins, and its monitor misses that part: norewinds.
    modules = [
        f"module-null-sink sink_name=rig norewinds=1 {form}",
        f"module-native-protocol-unix auth-anonymous=1 socket={runtime}/native",
        f"module-simple-protocol-tcp playback=true record=false sink=rig {form} listen=127.0.0.1 port={port}",
    ]
    with (tmp_path / "log").open("w") as log:
        server = subprocess.Popen(
            ["pulseaudio", "-n", "--daemonize=no", "--use-pid-file=no", "--exit-idle-time=-1", "--log-target=stderr"]
            + [word for module in modules for word in ("-L", module)],
            env=environment,
            stderr=log,
        )
        try:
            _wait_until_it_listens(server, port)
            yield f"127.0.0.1:{port}", environment
        finally:
            server.terminate()
            server.wait(10)


def _wait_until_it_listens(server: subprocess.Popen[bytes], port: int) -> None:
    while server.poll() is None:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=0.1).close()
        except OSError:
            continue
        return
    pytest.fail("PulseAudio did not start")
