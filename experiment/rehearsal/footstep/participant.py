"""REHEARSAL: a simulated participant with an experimenter at the keys, behind the console's port.

It sees what the experimenter's screen shows, steps with a foot that speaks through the tracker's port, feels
what the panel received from the actuator's port, and answers with a key. In the task `virtual` nothing but the
delivered waveform tells it which material was meant.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from experiment.clock import Clock
from experiment.desk.port import Console
from experiment.errors import TrackerError
from experiment.protocol.models import Protocol
from experiment.protocol.rules import LOUDER_KEY
from experiment.rehearsal.footstep.foot import Foot
from experiment.rehearsal.footstep.materials import SimulatedMaterials
from experiment.rehearsal.footstep.movement import Hesitation
from experiment.rehearsal.footstep.observer import Observer
from experiment.rehearsal.footstep.panel import CardPanel, Panel

Tick = Callable[[], None]
"""Called after each confirmed answer."""

FELT_TIMEOUT_S = 2.0
"""How long a participant waits for a stimulus before it says what it felt, wall-clock time."""

MOST_RESTS = 5
"""How often in a row a participant rests its foot for one zeroing. A busy machine may spoil one or two; a foot that
rests too far from contact always will."""

SPEED_MEDIAN_MM_S = 180.0
SPEED_SIGMA = 0.35
"""Foot speeds are log-normal about the natural steps of section 3.1: most within 50-300 mm/s."""

IN_VAIN = 0.03
"""Part of the steps that stop or turn back between gate and panel, half each."""

MASKED_DB_A = 60.0
"""Level from which on a simulated participant does not hear the voice coils."""

READY_S = (0.3, 1.2)
"""From arming to the beginning of a step, s."""

SPEAKS_LOG_S = (0.3, 0.3)
"""From contact to the keyed answer: mean and standard deviation of the logarithm of seconds; median 1.3 s."""


class SimulatedParticipant:
    """Implements `Console`."""

    def __init__(
        self,
        *,
        protocol: Protocol,
        materials: SimulatedMaterials,
        who: tuple[str, str],
        entropy: tuple[int, ...],
        foot: Foot,
        powered_ns: int,
        panel: Panel | CardPanel | None,
        actuator_rate_hz: int,
        clock: Clock,
        real_time: bool,
        tick: Tick,
        screen: Console | None,
    ) -> None:
        """Set a participant before the panel.

        Args:
            protocol: the study.
            materials: the simulated materials that lie beside the panel.
            who: label of the participant, and id of the task.
            entropy: names this participant's random draws in this task.
            foot: the foot, at the device's end of the tracker's port.
            powered_ns: session time at which the foot's device was powered, when its clock showed zero.
            panel: the panel, at the device's end of the actuator's port; None where the task has no actuator.
            actuator_rate_hz: samples a second of what the panel receives.
            clock: the session's clock; thinking and speaking let its time pass.
            real_time: whether the foot streams by the clock.
            tick: called after each confirmed answer.
            screen: shows what the experimenter would see; None for no screen.
        """
        self.who = who
        self._materials = materials
        self._entropy = entropy
        self._foot = foot
        self._panel = panel
        self._rate_hz = actuator_rate_hz
        self._clock = clock
        self._real_time = real_time
        self._tick = tick
        self._screen = screen
        self._origin_ns = powered_ns
        self._observer = Observer(materials, tuple(m.id for m in protocol.materials), rng=self._rng(0))
        self._observer.familiarise(rng=self._rng(0, 1))
        self._under_foot: str | None = None
        self._attempt = 0
        self._lands_later = False
        self._rested = 0

    def _rng(self, *keys: int) -> np.random.Generator:
        return np.random.default_rng([*self._entropy, *keys])

    def show(self, text: str) -> None:
        if self._screen is not None:
            self._screen.show(f"REHEARSAL  {text}")

    def familiarise(self, *, instruction: str, min_s: float, max_s: float) -> None:
        self.show(f"Familiarisation: {instruction}")
        wanted_s = self._rng(0, 2).uniform(min_s, max(max_s, min_s))
        self._clock.sleep_ns(int(wanted_s * 1e9))

    def level(
        self,
        *,
        level_db_a: float,
        limit_db_a: float,
        criterion: str,
        keys: dict[str, str],  # noqa: ARG002
    ) -> str:
        self.show(f"Masker at {level_db_a:.0f} dB(A), at most {limit_db_a:.0f}. {criterion}")
        return LOUDER_KEY if level_db_a < min(MASKED_DB_A, limit_db_a) else ""

    def rest(self, *, why: str) -> None:
        self._rested = self._rested + 1 if why else 1
        if self._rested > MOST_RESTS:
            raise TrackerError(
                f"{why}; the simulated foot rested {MOST_RESTS} times and cannot rest otherwise: give a rig and a "
                "protocol that agree"
            )
        self.show(f"{why or 'Zeroing'}: the foot rests on the panel")
        self._foot.put_down()

    def place(self, *, trial: int, material: str) -> None:
        self.show(f"Trial {trial}: {material} is laid out")
        self._under_foot = material

    def arm(self, *, trial: int, attempt: int, trials: int) -> None:
        if self._screen is not None:
            self._screen.arm(trial=trial, attempt=attempt, trials=trials)
        self._step(trial, attempt)

    def rearm(self, *, trial: int, attempt: int, reason: str) -> None:
        if self._screen is not None:
            self._screen.rearm(trial=trial, attempt=attempt, reason=reason)
        self._attempt = attempt
        if self._lands_later:
            self._lands_later = False
            return
        self._step(trial, attempt)

    def _step(self, trial: int, attempt: int) -> None:
        self._attempt = attempt
        rng = self._rng(trial, attempt, 0)
        speed_mm_s = float(np.clip(rng.lognormal(np.log(SPEED_MEDIAN_MM_S), SPEED_SIGMA), 55.0, 390.0))
        ready_ns = int(rng.uniform(*READY_S) * 1e9)
        now_ns = self._clock.now_ns()
        begin_ns = max(now_ns + ready_ns, self._origin_ns + self._foot.free_us * 1000)
        if not self._real_time:
            # Simulated time passes nowhere else; a foot that streams by the clock only has to know when.
            self._clock.sleep_ns(begin_ns - now_ns)
        while self._panel is not None and self._panel.felt(0) is not None:
            self.show("A stimulus of an attempt that did not count was felt")
        whim = self._rng(trial, attempt, 2)
        in_vain: Hesitation | None = None
        if whim.random() < IN_VAIN:
            in_vain = "stop" if whim.random() < 0.5 else "turn"
        trajectory = self._foot.trajectory(rng, speed_mm_s, in_vain)
        self._lands_later = trajectory.hesitation == "dip"
        self._foot.step(trajectory, (begin_ns - self._origin_ns) // 1000)

    def ask(self, *, trial: int, keys: dict[str, str]) -> str:
        rng = self._rng(trial, self._attempt, 1)
        speed_mm_s = self._foot.true_speed_mm_s
        if self._under_foot is not None:
            crinkle = self._materials.crinkle_take(self._under_foot, speed_mm_s=speed_mm_s, rng=rng)
            answer = self._observer.judge_real(crinkle, speed_mm_s=speed_mm_s, rng=rng)
        else:
            landing = self._materials.panel_take(speed_mm_s=speed_mm_s, rng=rng)
            answer = self._observer.judge_virtual(
                landing, self._delivered(), rate_hz=self._rate_hz, speed_mm_s=speed_mm_s, rng=rng
            )
        self._foot.finish()
        spoken_ns = self._origin_ns + int(self._foot.true_contact_us * 1e3) + int(rng.lognormal(*SPEAKS_LOG_S) * 1e9)
        self._clock.sleep_ns(spoken_ns - self._clock.now_ns())
        return next(key for key, meaning in keys.items() if meaning.startswith(answer))

    def _delivered(self) -> NDArray[np.float64] | None:
        return self._panel.felt(FELT_TIMEOUT_S) if self._panel is not None else None

    def confirmed(self, *, trial: int, answer: str | None) -> None:
        self._tick()
        if self._screen is not None:
            self._screen.confirmed(trial=trial, answer=answer)
