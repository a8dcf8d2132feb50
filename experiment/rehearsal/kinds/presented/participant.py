"""A simulated participant to whom stimuli are presented, who judges what the panel received.

An `Observer` feels a vibration by its sensation levels, dB above the threshold of a fingertip: those of third octaves
(`synthesis/noticing.py`), and those of windows in time. It remembers each material's as declared, off by `MEMORY_DB`,
and the more a stimulus differs from one, the less likely is that one's name. How strong it is, is its level as a whole.
None of the parameters is fitted, and all are ours.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.desk.messages import ENTER
from palpate.experiment.desk.questions import Arm, Event, Familiarise, Play, Played, Question, Reply
from palpate.experiment.protocol.kinds.presented import Presented
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.rehearsal.designs import Percept, judge_of
from palpate.experiment.rehearsal.kind import Parts, RehearsalKind
from palpate.experiment.rehearsal.participant import SimulatedPerson
from palpate.experiment.rehearsal.wires.panel import CardPanel, Panel
from palpate.experiment.session.kinds.presented.fidelity import sites
from palpate.experiment.session.kinds.presented.stimuli import rendered
from palpate.experiment.synthesis.noticing import FINGERTIP, THIRDS_HZ

MEMORY_DB, SENSITIVITY_PER_DB = 1.5, 0.2
THRESHOLD_SD_DB, TOLD_APART_DB = 1.0, 1.5

ELSEWHERE_DB = 15.0
"""What another site of the body adds to the difference of two stimuli, dB."""

WINDOW_S = 0.05
"""Touch follows how strong a vibration is from window to window, s."""

PRESSES_S = (0.3, 0.9)
"""From when something can be set off until its key is pressed, s."""

ANSWERS_LOG_S = (0.2, 0.3)
"""From the end of the last stimulus to the keyed answer: mean and sd of the logarithm of seconds; median 1.2 s."""

SETTLES_S = 0.08
"""So long after its end a stimulus has come through a sound card, s."""


@dataclass(frozen=True)
class Feeling:
    """Sensation levels, dB: of third octaves, shape (18,), of windows in time, shape (w,), and as a whole."""

    thirds_db: NDArray[np.float64]
    windows_db: NDArray[np.float64]
    whole_db: float

    def apart_db(self, other: Feeling) -> float:
        """Return the mean difference of third octaves that are felt in either, and that of windows, together."""
        either = (self.thirds_db > 0) | (other.thirds_db > 0)
        thirds = np.abs(self.thirds_db - other.thirds_db)[either]
        size = max(self.windows_db.size, other.windows_db.size)
        windows = [np.pad(one.windows_db, (0, size - one.windows_db.size)) for one in (self, other)]
        return float(thirds.mean() if thirds.size else 0.0) + float(np.abs(windows[0] - windows[1]).mean())


def feeling(moved_m_s2: NDArray[np.float64], rate_hz: int) -> Feeling:
    """Return what an acceleration, shape (n,), feels like; samples that are not numbers move nothing."""
    wave = np.nan_to_num(moved_m_s2)
    power = np.square(np.abs(np.fft.rfft(wave))) * 2 / wave.size**2
    frequencies_hz = np.fft.rfftfreq(wave.size, 1 / rate_hz)
    ends = np.searchsorted(frequencies_hz, [*(THIRDS_HZ / 10**0.05), THIRDS_HZ[-1] * 10**0.05])
    threshold = FINGERTIP.detected_m_s2
    relative = np.diff(np.concatenate([[0.0], np.cumsum(power)])[ends]) / threshold**2
    size = max(round(WINDOW_S * rate_hz), 1)
    squared = np.pad(np.square(wave), (0, -wave.size % size)).reshape(-1, size).mean(axis=1)
    return Feeling(_db(relative), _db(squared / threshold.min() ** 2), float(_db(relative.sum())))


def _db(ratio: Any) -> Any:
    """Return a ratio of powers in dB, at least 0."""
    return 10 * np.log10(np.maximum(ratio, 1.0))


@dataclass(frozen=True)
class Felt:
    """A stimulus, m/s^2, shape (n,), None for nothing, and the site of the body that felt it, if there are several."""

    moved_m_s2: NDArray[np.float64] | None
    site: str | None


@dataclass
class Observer:
    """The touch of a participant, which remembers stimuli and their sites by materials, in the order of the file."""

    remembered: Sequence[tuple[Feeling, str | None]]

    def percept(self, felt: Felt, rate_hz: int, rng: np.random.Generator) -> Percept:
        """Return what a stimulus felt like."""
        got = feeling(np.zeros(1) if felt.moved_m_s2 is None else felt.moved_m_s2, rate_hz)
        alike: NDArray[np.float64] = np.empty(0)
        if got.whole_db > abs(THRESHOLD_SD_DB * rng.normal()):
            apart_db = [got.apart_db(one) + ELSEWHERE_DB * (site != felt.site) for one, site in self.remembered]
            alike = -SENSITIVITY_PER_DB * np.array(apart_db)
        return Percept(alike, strength=got.whole_db, told_apart=TOLD_APART_DB)


@dataclass(kw_only=True)
class Presentee(SimulatedPerson):
    """Implements `Console`: a participant to whom stimuli are presented, and a simulated experimenter at the keys."""

    panels: Mapping[str | None, Panel | CardPanel]
    rate_hz: int
    real_time: bool
    _felt: list[Felt] = field(default_factory=list, init=False)
    _attempt: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        rng, stimuli = self._own_rng(), rendered(self.protocol, self.rate_hz)
        site_of = self.protocol.table(Presented).site_of
        feelings = [feeling(stimuli[one.id].waveform_m_s2, self.rate_hz) for one in self.protocol.materials]
        places = (site_of[one.id] for one in self.protocol.materials)
        self._observer = Observer([(_blurred(one, rng), site) for one, site in zip(feelings, places, strict=True)])

    def ask(self, question: Question | Arm) -> Reply:
        match question:
            case Familiarise(unfelt=True):
                return Reply(ENTER)
            case Arm(attempt=attempt):
                self._attempt, self._felt = attempt, []
                if self._collected().moved_m_s2 is not None:
                    self.show("The participant felt a stimulus in an attempt that did not count")
            case Play(trial=trial):
                self.clock.sleep_ns(int(self._rng(trial, self._attempt, 0).uniform(*PRESSES_S) * 1e9))
        return super().ask(question)

    def tell(self, event: Event) -> None:
        match event:
            case Played():
                if self.real_time:
                    time.sleep(SETTLES_S)
                self._felt.append(self._collected())
        super().tell(event)

    def _collected(self) -> Felt:
        """Return what the panels received since this was called last."""
        parts, at = [], None
        for site, panel in self.panels.items():
            while (part := panel.felt(0)) is not None:
                parts.append(part)
                at = site
        return Felt(np.concatenate(parts) if parts else None, at)

    def says(self, trial: int) -> tuple[str, str]:
        rng = self._rng(trial, self._attempt, 1)
        percepts = [self._observer.percept(one, self.rate_hz, rng) for one in self._felt]
        judged = judge_of(self.protocol.task(self.who[1]))(self.protocol, percepts, rng)
        self.clock.sleep_ns(int(rng.lognormal(*ANSWERS_LOG_S) * 1e9))
        return judged.key, judged.words


def _blurred(of: Feeling, rng: np.random.Generator) -> Feeling:
    off_db = MEMORY_DB * rng.normal(size=of.thirds_db.size)
    thirds_db = np.where(of.thirds_db > 0, np.maximum(of.thirds_db + off_db, 0.0), 0.0)
    return Feeling(thirds_db, of.windows_db, of.whole_db)


def _person(parts: Parts, **everybody: Any) -> Presentee:
    rate_hz = parts.rig.actuator.rate_hz
    return Presentee(**everybody, panels=parts.panels, rate_hz=rate_hz, real_time=parts.real_time)


def _lacks_nothing(rig: Rig, protocol: Protocol) -> None:
    sites(protocol, rig)
    rendered(protocol, rig.actuator.rate_hz)


REHEARSAL = RehearsalKind(
    person=_person, generic=lambda _: "", rig=lambda _: "rigs/presented.toml", lacks_nothing=_lacks_nothing
)
