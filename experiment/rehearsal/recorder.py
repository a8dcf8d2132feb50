"""SIMULATED recording: a foot at the tracker's port, a sensor at the accelerometer's, and nobody at the keys.

The walk and the drivers are those of a real recording; the simulated experimenter keeps what is on target.
"""

from __future__ import annotations

import queue
import socket
import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiment.apparatus import opening
from experiment.apparatus import rig as rigs
from experiment.apparatus.gate import GateDetector
from experiment.apparatus.rig import AccelerometerRig
from experiment.errors import RecordingError
from experiment.protocol import load
from experiment.recordings import partial, workflow
from experiment.recordings.manifest import Recordings
from experiment.recordings.plan import Condition, Plan, plan
from experiment.recordings.workflow import Step
from experiment.rehearsal import takes as takes_of
from experiment.rehearsal.foot import Foot
from experiment.rehearsal.serial_line import SerialLine
from experiment.rehearsal.takes import Session

REST_S = 0.05
"""The sensor hears this much of a panel at rest before a take, s."""

REST_NOISE_M_S2 = 0.002
"""Standard deviation of what it hears then, m/s^2."""

FRESH_SPEEDS_MM_S = (150.0, 250.0, 400.0)
FRESH_TAKES = 10
"""Okamoto et al., section 3.3."""

Tick = Callable[[], None]


class Sensor:
    """The far end of the accelerometer's port: listens on the loopback interface, one connection a take."""

    def __init__(self, settings: AccelerometerRig) -> None:
        """Listen at once.

        Args:
            settings: rate and full scale.
        """
        self._settings = settings
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._server.getsockname()[1]}"
        """Where it listens, `host:port`."""
        self._takes: queue.SimpleQueue[NDArray[np.float64] | None] = queue.SimpleQueue()
        self._closing = False
        self._thread = threading.Thread(target=self._listen, name="sensor", daemon=True)
        self._thread.start()

    def shake(self, take_m_s2: NDArray[np.float64], rng: np.random.Generator) -> None:
        """The panel shakes: whoever is connected hears it after a moment of rest.

        Args:
            take_m_s2: acceleration from first contact on, m/s^2, shape (n,), at the sensor's rate.
            rng: noise of the sensor at rest, before and after.
        """
        before = rng.normal(0.0, REST_NOISE_M_S2, round(REST_S * self._settings.rate_hz))
        # A take that begins quietly is noticed late, and then goes on for as much longer.
        after = rng.normal(0.0, REST_NOISE_M_S2, take_m_s2.size)
        self._takes.put(np.concatenate([before, take_m_s2, after]))

    def close(self) -> None:
        """Stop listening."""
        self._closing = True
        self._takes.put(None)
        # Closing the server alone would not end an accept that is under way.
        with suppress(OSError), socket.create_connection(self._server.getsockname(), timeout=1.0):
            pass
        self._thread.join()
        self._server.close()

    def _listen(self) -> None:
        while not self._closing:
            connection, _ = self._server.accept()
            with connection:
                heard = None if self._closing else self._takes.get()
                if heard is None:
                    return
                # Who hangs up has heard enough.
                with suppress(OSError):
                    connection.sendall((heard / self._settings.full_scale_m_s2).astype("<f4").tobytes())
                    while connection.recv(4096):
                        pass


class SimulatedExperimenter:
    """Implements `TakesConsole`: lays out, steps, and keeps every take without a problem."""

    def __init__(self, *, foot: Foot, sensor: Sensor, session: Session, tick: Tick) -> None:
        """Take a place at the panel.

        Args:
            foot: at the tracker's port.
            sensor: at the accelerometer's.
            session: every attempt at every take.
            tick: called after each kept take.
        """
        self._foot = foot
        self._sensor = sensor
        self._session = session
        self._tick = tick

    def place(self, condition: Condition, *, done: int, total: int) -> None:
        """Nothing has to be waited for."""

    def arm(self, condition: Condition, *, attempt: int) -> None:
        drawn = self._session.attempt(condition, attempt)
        rng = self._session.rng(condition, attempt, 1)
        self._foot.step(self._foot.trajectory(rng, drawn.speed_mm_s), 0)
        self._sensor.shake(drawn.samples_m_s2, rng)

    def keeps(self, step: Step) -> bool:
        self._foot.finish()
        if step.problems:
            return False
        self._tick()
        return True


def record_simulated(
    *,
    protocol_file: Path,
    rig_file: Path,
    out: Path,
    seed: int,
    speeds_mm_s: tuple[float, ...] = (),
    takes: int | None = None,
    total: Callable[[int], None] = lambda _: None,
    tick: Tick = lambda: None,
) -> Path:
    """Record SIMULATED materials unattended, or go on with it.

    Args:
        protocol_file: what is recorded; its materials have simulations.
        rig_file: of a simulated rig with an accelerometer.
        out: folder of the recordings; new or empty.
        seed: names every random draw.
        speeds_mm_s: instead of the protocol's; empty for those.
        takes: instead of the protocol's; None for those.
        total: called with the number of takes.
        tick: called after each kept take.

    Returns:
        Path of the manifest.

    Raises:
        PalpateError: a file that cannot be used, or a material without simulation.
    """
    protocol, rig = load.load(protocol_file), rigs.load(rig_file)
    if not rig.rig.simulated:
        raise RecordingError(f"{rig_file}: a real rig; allowed: one that says simulated = true; leave out --simulated")
    rigs.check(rig, protocol.step)
    planned = plan(protocol, source=takes_of.source(seed), simulated=True, speeds_mm_s=speeds_mm_s, takes=takes)
    partial.check(out, planned)
    drawn = takes_of.session(planned, seed=seed)
    total(len(planned.conditions()))
    with ExitStack() as opened:
        line = opened.enter_context(SerialLine())
        foot = Foot(line, rig.tracker)
        opened.callback(foot.close)
        tracker = opening.open_tracker(rig, port=line.url)
        opened.callback(tracker.close)
        sensor = Sensor(opening.accelerometer_of(rig))
        opened.callback(sensor.close)
        accelerometer = opening.open_accelerometer(rig, rate_hz=planned.rate_hz, address=sensor.address)
        opened.callback(accelerometer.close)
        experimenter = SimulatedExperimenter(
            foot=foot,
            sensor=sensor,
            session=drawn,
            tick=tick,
        )
        return workflow.record(
            planned,
            out,
            tracker=tracker,
            accelerometer=accelerometer,
            detector=GateDetector(protocol.step),
            console=experimenter,
        )


def fresh_takes(
    recorded: Recordings,
    *,
    seed: int,
    speeds_mm_s: tuple[float, ...] = FRESH_SPEEDS_MM_S,
    takes: int = FRESH_TAKES,
) -> Recordings:
    """New SIMULATED takes of the materials of simulated recordings, of a foot that aims at the speeds asked for.

    Args:
        recorded: simulated recordings.
        seed: names every random draw; none is one of a recording's.
        speeds_mm_s: rising.
        takes: of each material, and of the bare panel, at each speed.

    Raises:
        RecordingError: recordings of real materials, or of one without simulation.
    """
    if not recorded.simulated:
        raise RecordingError(
            "fresh takes: got none; allowed: takes of the real materials, for the recordings are real; record them "
            "with palpate record --speeds 150,250,400 --takes 10, then name their folder with --fresh"
        )
    planned = Plan(
        source=f"SIMULATED fresh takes, seed {seed}",
        simulated=True,
        materials=tuple(recorded.objects),
        speeds_mm_s=speeds_mm_s,
        takes=takes,
        rate_hz=recorded.rate_hz,
        samples=recorded.panel.shape[-1],
    )
    return Session(planned, seed=seed, number=0).recordings()
