"""What each scene holds of a machine, seen from outside: a process of each task on one audio rig, and a JACK client."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass

import jack
import pytest

from experiment.apparatus import rig as rigs
from experiment.protocol import files
from experiment.protocol.files import shipped
from experiment.rehearsal.footstep import recorded_takes
from experiment.rehearsal.footstep.foot import Foot
from experiment.rehearsal.wires.serial_line import SerialLine
from experiment.rehearsal.wires.sound_card import SoundCard
from tests.rig.laboratory import write_rig

OPENED = """
import sys, time
begun = time.perf_counter()
import json
from pathlib import Path
from experiment.apparatus import rig as rigs
from experiment.clock import MonotonicClock
from experiment.desk.terminal import TerminalConsole
from experiment.protocol import files
from experiment.session.laboratory import open_laboratory
from experiment.session.run import RealEnds
task, protocol, rig_file, recordings, dataset = sys.argv[1], *map(Path, sys.argv[2:])
ends = RealEnds(TerminalConsole(write=sys.stderr, ask=lambda _: "y", heading=""))
# Its priority is no matter here.
ends.real_time = False
with open_laboratory(
    protocol=files.load(protocol), rig=rigs.load(rig_file), rig_folder=rig_file.parent,
    participant="01", task_id=task, dataset=dataset, recordings=recordings if task == "virtual" else None,
    clock=MonotonicClock(), ends=ends,
):
    wall_s, cpu_s = time.perf_counter() - begun, time.process_time()
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    held = {"mb": int(status["VmRSS"].split()[0]) * 1.024e-3, "threads": int(status["Threads"])}
    held |= {"wall_s": wall_s, "cpu_s": cpu_s}
    print(json.dumps(held | {"modules": sorted(sys.modules)}), flush=True)
    sys.stdin.readline()
"""
"""A session up to its first trial, without a participant: everything open, and then waiting."""


@dataclass(frozen=True)
class Held:
    """What a process holds: resident memory, MB, threads, modules, the time that opening it took, s, by the clock and
    of the processor, and how many of its ports a client of the server sees.
    """

    mb: float
    threads: int
    modules: frozenset[str]
    wall_s: float
    cpu_s: float
    outputs: int
    inputs: int


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Held]]:
    folder = tmp_path_factory.mktemp("scenes")
    protocol, settings = files.load(shipped("okamoto2012.toml")), rigs.load(shipped("rigs/headless.toml"))
    recordings = recorded_takes.make_recordings(folder / "r", protocol=protocol, seed=1).parent
    audio, found = settings.audio, dict[str, Held]()
    assert audio is not None
    channels = audio.channels
    with (
        SerialLine() as line,
        closing(Foot(line, settings.tracker, real_time=True)),
        closing(
            SoundCard(rate_hz=audio.rate_hz, block=audio.block, inputs=channels.inputs, outputs=channels.outputs)
        ) as card,
    ):
        rig = write_rig(folder, "headless", port=f'"{line.url}"', device='"system"')
        quiet = folder / "quiet.toml"
        text = shipped("okamoto2012.toml").read_text("utf-8")
        quiet.write_text(text.replace('id = "real"', 'id = "real"\nmasker = "none"'), "utf-8")
        asked = {"virtual": ("virtual", shipped("okamoto2012.toml")), "real": ("real", shipped("okamoto2012.toml"))}
        for name, (task, study) in (asked | {"quiet": ("real", quiet)}).items():
            opened = subprocess.Popen(
                [sys.executable, "-c", OPENED, task, study, rig, recordings, folder / "dataset"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            assert opened.stdout is not None
            told = json.loads(opened.stdout.readline())
            outside = jack.Client("outside", servername=card.name, no_start_server=True)
            outputs, inputs = (len(outside.get_ports(f"^PortAudio.*:{kind}_[0-9]+$")) for kind in ("out", "in"))
            outside.close()
            opened.communicate("\n", timeout=60)
            assert opened.returncode == 0
            modules = frozenset(told.pop("modules"))
            found[name] = Held(**told, modules=modules, outputs=outputs, inputs=inputs)
        yield found


def test_a_task_with_real_objects_opens_no_port_of_the_actuator(held: dict[str, Held]) -> None:
    # The rig: headphones on outputs 1 and 2, the actuator on 3; a microphone and the actuator's loopback on inputs.
    assert (held["virtual"].outputs, held["virtual"].inputs) == (3, 2)
    assert (held["real"].outputs, held["real"].inputs) == (2, 0)
    # Without a masker nothing of the device is needed.
    assert (held["quiet"].outputs, held["quiet"].inputs) == (0, 0)
    assert "sounddevice" not in held["quiet"].modules


def test_a_task_with_real_objects_holds_70_mb_less_and_begins_half_a_second_sooner(held: dict[str, Held]) -> None:
    virtual, real = held["virtual"], held["real"]
    assert virtual.mb - real.mb > 70
    # A busy machine has its way with the clock on the wall.
    assert virtual.cpu_s - real.cpu_s > 0.5
    assert real.threads <= virtual.threads


def test_neither_loads_what_numpy_serves_and_the_real_task_nothing_of_a_stimulus(held: dict[str, Held]) -> None:
    assert not {name for one in held.values() for name in one.modules if name.startswith("scipy.signal")}
    unneeded = ("scipy", "experiment.recordings", "experiment.apparatus.panel", "experiment.apparatus.audio.actuator")
    assert not {name for name in held["real"].modules if name.startswith(unneeded)}
    assert {name for name in held["real"].modules if name.startswith("experiment.synthesis.")} == {
        "experiment.synthesis.noise"
    }
