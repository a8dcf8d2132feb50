"""How soon a session can begin: run `python -m tests.benchmarks.starts [TURNS]`.

A laboratory has a rig with sound, a JACK server with its dummy driver and a foot on a serial line, and `palpate run` is
called there for tasks that need more and more of it. The time is that from the command to its first question: by then
all is checked and open. The question is answered with no, so nothing is begun. The studies take turns.

Recordings and the response of the panel are SIMULATED, and stand in for a laboratory's own in a folder that is deleted.
Not a test: it asserts nothing, because these figures belong to the machine that printed them.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from datetime import date, timedelta
from pathlib import Path

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
from palpate.experiment.rehearsal.wires.foot import Foot
from palpate.experiment.rehearsal.wires.serial_line import SerialLine
from palpate.experiment.rehearsal.wires.sound_card import DEVICE, SoundCard
from palpate.experiment.study.schedule import allocate
from tests.rig.laboratory import write_rig

TURNS = 9

STUDIES = {
    "real objects, no masker": ("real", 'masker = "none"'),
    "real objects, pink noise": ("real", 'masker = "pink"'),
    "virtual stimuli, pink noise": ("virtual", 'masker = "pink"'),
}
"""The task of each, and what the protocol of Okamoto et al. says of it besides."""


def begun_s(command: list[str]) -> float:
    """Return how long a session took until it asked who is there, s."""
    began_s = time.monotonic()
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.STDOUT) as session:
        assert session.stdout is not None
        said = b""
        while b"in front of you" not in said:
            more = os.read(session.stdout.fileno(), 4096)
            if not more:
                raise RuntimeError(said.decode("utf-8", "replace"))
            said += more
        taken_s = time.monotonic() - began_s
        session.communicate(b"n\n", timeout=30)
    return taken_s


def prepared(folder: Path, rig: Path, task: str, text: str) -> list[str]:
    """Return the command that runs the first participant of a study in a task, which is sealed for that."""
    folder.mkdir()
    study, today = folder / "study.toml", date.today()
    study.write_text(text, "utf-8")
    protocol = files.load(study)
    if protocol.task(task).masker is None:
        raise ValueError(f"the protocol says nothing of the masker in task {task}")
    manifest = recorded_takes.make_recordings(folder / "recordings", protocol=protocol, seed=1)
    manifest.write_text(manifest.read_text("utf-8").replace("simulated = true", "simulated = false"), "utf-8")
    seed = next(seed for seed in range(100) if allocate(protocol, seed)[0].tasks[0] == task)
    palpate = [sys.executable, "-m", "palpate.experiment"]
    where = ["--dataset", str(folder / "dataset")]
    days = ["--approved-on", str(today), "--expires-on", str(today + timedelta(9))]
    for asked in (
        ["seal", str(study), "--approval-number", "benchmark", *days],
        ["enrol", str(study), "-p", "01", "--consent-on", str(today), "--seed", str(seed), *where],
    ):
        subprocess.run([*palpate, *asked], check=True, stdout=subprocess.DEVNULL)
    devices = ["--rig", str(rig), "--recordings", str(folder / "recordings"), "--lines"]
    return [*palpate, "run", str(study), "-p", "01", "--task", task, *where, *devices]


def main(turns: int) -> None:
    """Print the figures."""
    settings = rigs.load(shipped("rigs/headless.toml"))
    audio = settings.audio
    assert audio is not None
    inputs, outputs = audio.channels.inputs, audio.channels.outputs
    text = shipped("okamoto2012.toml").read_text("utf-8")
    with (
        tempfile.TemporaryDirectory() as temporary,
        SerialLine() as line,
        closing(Foot(line, tracker_of(settings), real_time=True)),
        closing(SoundCard(rate_hz=audio.rate_hz, block=audio.block, inputs=inputs, outputs=outputs)),
    ):
        folder = Path(temporary)
        rig = write_rig(folder, "headless", port=f'"{line.url}"', device=f'"{DEVICE}"')
        commands = {
            name: prepared(folder / str(number), rig, task, text.replace(f'id = "{task}"', f'id = "{task}"\n{told}'))
            for number, (name, (task, told)) in enumerate(STUDIES.items())
        }
        taken_s: dict[str, list[float]] = {name: [] for name in commands}
        for _ in range(turns):
            for name, command in commands.items():
                taken_s[name].append(begun_s(command))
    for name, each_s in taken_s.items():
        print(f"{name:<44} {statistics.median(each_s):.2f} s ({min(each_s):.2f} to {max(each_s):.2f})")


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else TURNS)
