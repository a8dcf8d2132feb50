"""`palpate run` on a rig whose accelerometer hears the panel: both SIMULATED, in real time."""

from __future__ import annotations

import csv
import hashlib
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from datetime import date
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment import storage
from palpate.experiment.apparatus import host
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel import multisine
from palpate.experiment.apparatus.panel.movement import COLUMNS, DRIFT_DB
from palpate.experiment.protocol import files
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Note
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
from palpate.experiment.rehearsal.wires.panel import Panel
from palpate.experiment.rehearsal.wires.sensor import REST_NOISE_M_S2
from tests.conftest import Palpate
from tests.rig.laboratory import Laboratory
from tests.rig.test_run import counted_steps, keys, laboratory

pytestmark = pytest.mark.alone

__all__ = ["laboratory"]

GAIN_M_S2 = 50.0
"""What a sample of 1.0 moves the panel by, at every frequency, as `tests.rig.laboratory.measured` states it."""

FULL_M_S2, LATE_S, TICK_S = 100.0, 0.012, 0.004
"""Of the sensor: full scale, how late it hears, and how often it sends."""


class Sensing:
    """A server of raw samples without end: noise, and what is pushed to it."""

    def __init__(self, rate_hz: int) -> None:
        self.rate_hz = rate_hz
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._server.getsockname()[1]}"
        self._moves = np.zeros(0)
        self._lock = threading.Lock()
        self._closing = False
        self._rng = np.random.default_rng(1)
        self._thread = threading.Thread(target=self._listen, daemon=True)
        with host.elsewhere():
            self._thread.start()

    def push(self, moved_m_s2: NDArray[np.float64]) -> None:
        """Hear a movement from `LATE_S` on, or after what is to be heard already."""
        with self._lock:
            late = np.zeros(0 if self._moves.size else round(LATE_S * self.rate_hz))
            self._moves = np.concatenate([self._moves, late, moved_m_s2])

    def close(self) -> None:
        self._closing = True
        with suppress(OSError), socket.create_connection(self._server.getsockname(), timeout=1.0):
            pass
        self._thread.join()
        self._server.close()

    def _listen(self) -> None:
        while not self._closing:
            connection, _ = self._server.accept()
            with connection, suppress(OSError):
                self._send(connection)

    def _send(self, connection: socket.socket) -> None:
        began_s, sent = time.monotonic(), 0
        while not self._closing:
            due = round((time.monotonic() - began_s) * self.rate_hz) - sent
            with self._lock:
                moves, self._moves = self._moves[:due], self._moves[due:]
            heard = self._rng.normal(0.0, REST_NOISE_M_S2, due)
            heard[: moves.size] += moves
            connection.sendall((heard / FULL_M_S2).astype("<f4").tobytes())
            sent += due
            time.sleep(TICK_S)


@pytest.fixture
def sensing(monkeypatch: pytest.MonkeyPatch) -> Iterator[Sensing]:
    """What hears the panel of the laboratory, as it plays."""
    with closing(Sensing(5000)) as there:

        def pieces(self: Panel) -> None:
            while True:
                connection, _ = self._server.accept()
                # A connection that is reset plays no more.
                with connection, suppress(OSError):
                    if self._closing.is_set():
                        return
                    began_s, data = time.monotonic(), b""
                    for piece in iter(partial(connection.recv, 65536), b""):
                        whole = len(data) // 4 * 4
                        data += piece
                        fresh = data[whole : len(data) // 4 * 4]
                        there.push(np.frombuffer(fresh, "<f4").astype(np.float64) * GAIN_M_S2)
                    self._closing.wait(began_s + len(data) / 4 / 5000 - time.monotonic())

        monkeypatch.setattr(Panel, "_listen", pieces)
        yield there


@pytest.fixture
def task() -> str:
    return "virtual"


def test_what_the_accelerometer_hears_of_each_stimulus_is_on_record(
    sensing: Sensing, laboratory: Laboratory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, palpate: Palpate
) -> None:
    rig_file, table = tmp_path / "rig.toml", tmp_path / "panel.csv"
    had = hashlib.sha256(table.read_bytes()).hexdigest()
    rows = "".join(f"{hz},{GAIN_M_S2},0,0.01,1\n" for hz in multisine.lines(sensing.rate_hz))
    table.write_text(f"# With nobody on the panel.\n{','.join(COLUMNS)}\n{rows}", "utf-8")
    stated = rig_file.read_text("utf-8").replace(had, hashlib.sha256(table.read_bytes()).hexdigest())
    with rig_file.open("w", encoding="utf-8") as file:
        file.write(
            f"{stated}\n"
            f'[accelerometer]\ndriver = "pcm-tcp"\naddress = "{sensing.address}"\nrate_hz = {sensing.rate_hz}\n'
            f"full_scale_m_s2 = {FULL_M_S2}\ntrigger_m_s2 = 0.5\nstays = true\ncalibrated_on = {date.today()}\n"
        )
    assert rigs.load(rig_file).actuator.rate_hz == sensing.rate_hz
    recordings = tmp_path / "recordings"
    manifest = recorded_takes.make_recordings(recordings, protocol=files.load(tmp_path / "study.toml"), seed=1)
    manifest.write_text(manifest.read_text("utf-8").replace("simulated = true", "simulated = false"), "utf-8")
    typed = iter("ccaanntt")
    monkeypatch.setattr("builtins.input", lambda prompt: next(typed) if keys(prompt) else "y" * ("[y]" in prompt))
    where = ["--rig", rig_file, "--dataset", "dataset", "--recordings", recordings]
    code, _, err = palpate("run", "study.toml", "-p", "01", "--task", "virtual", *where)
    assert code == 0, err
    folder = tmp_path / "dataset" / "sourcedata" / "sub-01"
    entries = journal.read(folder / "sub-01_task-virtual_journal.jsonl").entries
    assert sum("differs by" in e.text for e in entries if isinstance(e, Note)) == 1
    stimuli = [step.stimulus for step in counted_steps(entries)]
    assert len(stimuli) == 4
    for stimulus in stimuli:
        assert stimulus is not None
        assert stimulus.heard is not None
        assert stimulus.heard.problem == ""
        assert stimulus.heard.peak_m_s2 is not None
        assert stimulus.moved is not None
        # The session compared its panel, which is the measured one.
        assert stimulus.moved.drift_db is not None
        assert stimulus.moved.drift_db < DRIFT_DB / 2
        assert stimulus.heard.peak_m_s2 == pytest.approx(stimulus.moved.peak_m_s2, rel=0.05, abs=5 * REST_NOISE_M_S2)
        assert stimulus.heard.gain == pytest.approx(1.0, abs=0.02)
        assert stimulus.heard.delay_ms is not None
        # As late as the sensor; a busy machine hands either stream over late, so that this may be less, too.
        assert abs(stimulus.heard.delay_ms - LATE_S * 1e3) < 100
        assert len(stimulus.heard.thirds_db) == 18
        assert len(stimulus.heard.sent_thirds_db) == 18
    built = storage.read_text(tmp_path / "dataset" / "sub-01" / "beh" / "sub-01_task-virtual_events.tsv")
    table_rows = [row for row in csv.DictReader(built.splitlines(), delimiter="\t") if row["counted"] == "1"]
    assert len(table_rows) == 4
    for row, stimulus in zip(table_rows, stimuli, strict=True):
        sent, heard = (np.array(row[name].split(" | "), float) for name in ("sent_thirds", "heard_thirds"))
        # Quieter ones drown in the noise of the sensor.
        loud = sent >= sent.max() - 20
        assert np.abs(heard - sent)[loud].max() < 0.5
        assert float(row["heard_peak"]) == pytest.approx(float(row["sent_peak"]), rel=0.05, abs=5 * REST_NOISE_M_S2)
        assert float(row["heard_gain"]) == pytest.approx(1.0, abs=0.02)
        assert stimulus is not None
        assert stimulus.heard is not None
        assert float(row["heard_delay"]) == pytest.approx(0.001 * (stimulus.heard.delay_ms or 0.0), abs=1e-6)
