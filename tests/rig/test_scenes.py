"""What each scene holds of a machine, seen from outside: a process of each task on one audio rig, and a JACK client."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass

import jack
import pytest

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.held import Asked, Held, started
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
from palpate.experiment.rehearsal.wires.foot import Foot
from palpate.experiment.rehearsal.wires.serial_line import SerialLine
from palpate.experiment.rehearsal.wires.sound_card import SoundCard
from tests.rig.laboratory import write_rig


@dataclass(frozen=True)
class Seen:
    """What a process says that it holds, and how many of its ports a client of the server sees."""

    held: Held
    outputs: int
    inputs: int


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Seen]]:
    folder = tmp_path_factory.mktemp("scenes")
    protocol, settings = files.load(shipped("okamoto2012.toml")), rigs.load(shipped("rigs/headless.toml"))
    recordings = recorded_takes.make_recordings(folder / "r", protocol=protocol, seed=1).parent
    audio, found = settings.audio, dict[str, Seen]()
    assert audio is not None
    channels = audio.channels
    with (
        SerialLine() as line,
        closing(Foot(line, tracker_of(settings), real_time=True)),
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
            with ExitStack() as opened:
                told = started(Asked(str(study), str(rig), task, str(recordings)), opened)
                outside = jack.Client("outside", servername=card.name, no_start_server=True)
                outputs, inputs = (len(outside.get_ports(f"^PortAudio.*:{kind}_[0-9]+$")) for kind in ("out", "in"))
                outside.close()
            found[name] = Seen(told, outputs=outputs, inputs=inputs)
        yield found


def test_a_task_with_real_objects_opens_no_port_of_the_actuator(held: dict[str, Seen]) -> None:
    # The rig: headphones on outputs 1 and 2, the actuator on 3; a microphone and the actuator's loopback on inputs.
    assert (held["virtual"].outputs, held["virtual"].inputs) == (3, 2)
    assert (held["real"].outputs, held["real"].inputs) == (2, 0)
    # Without a masker nothing of the device is needed.
    assert (held["quiet"].outputs, held["quiet"].inputs) == (0, 0)
    assert "sounddevice" not in held["quiet"].held.modules


def test_a_task_with_real_objects_holds_70_mb_less_and_begins_with_less_work(
    held: dict[str, Seen],
) -> None:
    virtual, real = held["virtual"].held, held["real"].held
    assert virtual.mb - real.mb > 70
    # How many seconds that is belongs to the machine: `palpate plan` prints them.
    assert virtual.cpu_s > 1.5 * real.cpu_s
    assert real.threads <= virtual.threads


def test_neither_loads_what_numpy_serves_and_the_real_task_nothing_of_a_stimulus(held: dict[str, Seen]) -> None:
    assert not {name for one in held.values() for name in one.held.modules if name.startswith("scipy.signal")}
    unneeded = (
        "scipy",
        "palpate.experiment.recordings",
        "palpate.experiment.apparatus.panel",
        "palpate.experiment.apparatus.audio.actuator",
    )
    assert not {name for name in held["real"].held.modules if name.startswith(unneeded)}
    assert {name for name in held["real"].held.modules if name.startswith("palpate.experiment.synthesis.")} == {
        "palpate.experiment.synthesis.signals",
        "palpate.experiment.synthesis.signals.noise",
    }
