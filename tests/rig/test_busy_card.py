"""A sound card that another program holds, for real: the kernel, ALSA and PortAudio each say so in their own words.

A machine without a sound card has none that can be held. Here an ALSA device captures from a terminal, and the kernel
lets nobody open a terminal that is held exclusively (`TIOCEXCL`), as it lets nobody open a card that is in use.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tty
from collections.abc import Iterator
from dataclasses import dataclass
from fcntl import ioctl
from pathlib import Path
from termios import TIOCEXCL, TIOCNXCL

import pytest
from syrupy.assertion import SnapshotAssertion

from tests.rig.laboratory import write_rig

pytestmark = pytest.mark.clocked

ALSA = """\
</usr/share/alsa/alsa.conf>
pcm.card {{
    type file
    format "raw"
    slave.pcm {{ type null }}
    file "/dev/null"
    infile "{terminal}"
    hint.description "a card that can be held"
}}
"""

OPENS = """
import sys
from palpate.experiment.apparatus.audio.stream import find
from palpate.experiment.apparatus.audio.stream import AudioStream, StreamSettings
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.errors import AudioError

print(find(host_api="ALSA", name="card", inputs=2, outputs=4) >= 0, flush=True)
sys.stdin.readline()
try:
    AudioStream(StreamSettings("ALSA", "card", 48_000, 256, 2, (0.0,) * 4), MonotonicClock())
except AudioError as error:
    print(error)
"""


@dataclass(frozen=True)
class Card:
    """A card that this process can hold; `command` runs Python as a user whom that keeps out."""

    terminal: int
    command: tuple[str, ...]
    environment: dict[str, str]

    def hold(self) -> None:
        ioctl(self.terminal, TIOCEXCL)

    def release(self) -> None:
        ioctl(self.terminal, TIOCNXCL)


@pytest.fixture
def card(tmp_path: Path) -> Iterator[Card]:
    if importlib.util.find_spec("sounddevice") is None or not sys.platform.startswith("linux"):
        pytest.skip("needs Linux, and the package sounddevice")
    kept_out: tuple[str, ...] = ()
    if os.geteuid() == 0:
        setpriv = shutil.which("setpriv")
        if setpriv is None:
            pytest.skip("needs setpriv (package util-linux), for root is kept out of nothing")
        kept_out = (setpriv, "--inh-caps=-sys_admin", "--bounding-set=-sys_admin")
    far, terminal = os.openpty()
    tty.setraw(terminal)
    config = tmp_path / "alsa.conf"
    config.write_text(ALSA.format(terminal=os.ttyname(terminal)), "utf-8")
    yield Card(terminal, (*kept_out, sys.executable), {**os.environ, "ALSA_CONFIG_PATH": str(config)})
    os.close(terminal)
    os.close(far)


def test_a_card_that_is_taken_before_it_is_opened_is_said_to_be_held(card: Card, approved: SnapshotAssertion) -> None:
    pipe = subprocess.PIPE
    command = [*card.command, "-c", OPENS]
    with subprocess.Popen(command, env=card.environment, text=True, stdin=pipe, stdout=pipe, stderr=pipe) as opening:
        assert opening.stdout is not None
        listed = opening.stdout.readline()
        card.hold()
        said, errors = opening.communicate("\n")
    assert listed == "True\n", errors
    assert "resource busy" in errors
    assert said == approved, errors


def test_a_card_that_is_held_from_the_start_is_red_with_the_remedy(
    card: Card, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    rig = write_rig(tmp_path, "headless", host_api='"ALSA"', port='"/dev/no-such-port"', device='"card"')
    rig.write_text(rig.read_text("utf-8").replace(' Audio Connection Kit"', ""), "utf-8")
    card.hold()
    doctor = [
        *card.command,
        "-m",
        "palpate.experiment",
        "doctor",
        "--rig",
        str(rig),
        "--dataset",
        str(tmp_path),
        "--json",
    ]
    done = subprocess.run(doctor, env=card.environment, capture_output=True, text=True, check=False)
    card.release()
    assert done.returncode == 2, done.stderr
    [found] = [check for check in json.loads(done.stdout)["checks"] if check["name"] == "audio device"]
    assert found["verdict"] == "red"
    assert "128 outputs and 0 inputs" in found["measured"]
    assert found["remedy"] == approved
