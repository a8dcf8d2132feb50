"""`palpate calibrate tracker` and `palpate devices` over a real port, unattended: a hand that obeys the prompts."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus import rig
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.tracker import serial_port
from palpate.experiment.apparatus.tracker.frames import encode
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.wires.serial_line import SerialLine
from tests.conftest import Palpate

pytestmark = pytest.mark.clocked

NOISE_MM = 0.05


class Sensor:
    """SIMULATED: a target that a hand holds at a height, before the sensor of the rehearsal's rig."""

    def __init__(self, line: SerialLine) -> None:
        self._mm = 0.0
        self._moving = threading.Lock()
        self._line = line
        self._truth = rig.tracker_of(rig.load(shipped("rigs/rehearsal.toml")))
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._send)
        self._thread.start()

    def _send(self) -> None:
        rng = np.random.default_rng(1)
        sent = 0
        while not self._over.wait(0.002):
            with self._moving:
                counts = self._truth.counts(self._mm + rng.normal(0, NOISE_MM, 50)).tolist()
                frames = (encode(sent + i, 1000 * (sent + i), reading) for i, reading in enumerate(counts))
                self._line.offer(b"".join(frames))
            sent += len(counts)

    def hold(self, mm: float) -> None:
        """Hold the target at another height; nothing is sent of the one before from now on."""
        with self._moving:
            self._mm = mm

    def close(self) -> None:
        self._over.set()
        self._thread.join()


@pytest.fixture
def sensor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Sensor]:
    with SerialLine() as line:
        held = Sensor(line)
        text = shipped("rigs/rehearsal.toml").read_text("utf-8").replace("simulated = true", "simulated = false")
        text = text.replace('port = "rehearsal"', f'port = "{line.url}"').replace('"rehearsal"', '"127.0.0.1:9"')
        (tmp_path / "rig.toml").write_text(text.replace('name = "127.0.0.1:9"', 'name = "bench"'), "utf-8")

        def obey(prompt: str) -> str:
            found = re.search(r"hold the target (\S+) mm above", prompt)
            assert found
            held.hold(float(found[1]))
            return ""

        monkeypatch.setattr("builtins.input", obey)
        monkeypatch.chdir(tmp_path)
        yield held
        held.close()


def test_a_calibration_finds_the_sensor_and_writes_a_new_rig_file(
    sensor: Sensor, palpate: Palpate, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    before = (tmp_path / "rig.toml").read_bytes()
    where = ["--rig", "rig.toml", "--out", "new.toml", "--protocol", shipped("okamoto2012.toml")]
    code, out, err = palpate("calibrate", "tracker", *where, "--points=-5,0,10,20,50,100", "--days", "30")
    assert (code, err) == (0, "")
    assert [re.findall(rf"{part} \((\d+) mm\)", out) for part in ("gate", "panel")] == [["20"], ["0"]]
    made = tracker_of(rig.load(tmp_path / "new.toml"))
    truth = tracker_of(rig.load(shipped("rigs/rehearsal.toml")))
    assert [p.mm for p in made.calibration] == [p.mm for p in truth.calibration]
    # The last point lies at the converter's end, which cuts off half of the noise.
    assert [p.counts for p in made.calibration] == pytest.approx([p.counts for p in truth.calibration], abs=2)
    assert (made.calibrated_on, made.calibration_days) == (date.today(), 30)
    assert made.noise_mm == pytest.approx(NOISE_MM, rel=0.15)
    assert (tmp_path / "rig.toml").read_bytes() == before
    code, _, err = palpate("calibrate", "tracker", *where)
    assert code == 2
    assert err == approved


def test_without_a_new_file_the_table_is_printed(sensor: Sensor, palpate: Palpate, tmp_path: Path) -> None:
    code, out, _ = palpate("calibrate", "tracker", "--rig", "rig.toml", "--points", "0,50")
    assert code == 0
    assert f"calibrated_on = {date.today()}\ncalibration_days = 90\n" in out
    assert [path.name for path in tmp_path.iterdir()] == ["rig.toml"]


def test_heights_that_do_not_reach_past_the_gate_write_nothing(
    sensor: Sensor, palpate: Palpate, tmp_path: Path
) -> None:
    where = ["--rig", "rig.toml", "--out", "new.toml", "--protocol", shipped("okamoto2012.toml")]
    code, out, err = palpate("calibrate", "tracker", *where, "--points", "0,10,20")
    assert (code, "residual mm" in out) == (2, True)
    assert re.search(r"covers 0 to 20 mm; .* -1 to 25 mm", err)
    assert not (tmp_path / "new.toml").exists()


def test_a_target_that_stays_where_it_is_calibrates_nothing(
    sensor: Sensor, palpate: Palpate, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("builtins.input", lambda _: "")
    code, _, err = palpate("calibrate", "tracker", "--rig", "rig.toml", "--points", "0,50")
    assert code == 2
    assert re.search(r": got \d+(\.5)? counts .*; make sure", err)
    assert err.count("\n") == 1


def test_a_calibration_can_be_interrupted(
    sensor: Sensor, palpate: Palpate, monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
) -> None:
    def interrupted(_: str) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr("builtins.input", interrupted)
    code, _, err = palpate("calibrate", "tracker", "--rig", "rig.toml", "--out", "new.toml")
    assert code == 130
    assert err == approved
    assert not Path("new.toml").exists()


def test_devices_are_listed(palpate: Palpate, approved: SnapshotAssertion) -> None:
    code, out, err = palpate("devices")
    assert (code, err) == (0, "")
    assert out.splitlines()[0] == approved
    assert all(device.port in out for device in serial_port.devices())
    found = json.loads(palpate("devices", "--json")[1])
    assert [device["port"] for device in found["serial"]] == [device.port for device in serial_port.devices()]


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="only Linux tells who holds a port")
def test_who_holds_a_port_is_named() -> None:
    with SerialLine() as line:
        holder = subprocess.Popen(
            [
                sys.executable,
                "-c",
                "import sys; f = open(sys.argv[1], 'rb'); print(flush=True); sys.stdin.read()",
                line.url,
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert holder.stdout is not None
        holder.stdout.readline()
        assert any(held.endswith(f"({holder.pid})") for held in serial_port.holders(line.url))
        assert all(not held.endswith(f"({os.getpid()})") for held in serial_port.holders(line.url))
        holder.communicate()
        assert serial_port.holders(line.url) == ()
