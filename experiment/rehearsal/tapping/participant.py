"""A simulated participant who compares two samples by tapping them.

It judges a sample's hardness by how high its taps feel (`surfaces.felt_hz`), and by nothing else: in each trial both
samples are felt with an error of their own, and the one that felt higher is called the harder. A pair that feels nearly
alike is thus called by chance, and takes longer.

The parameters are few, and none was fitted to percentages of right answers:

- `DISCRIMINATION`: the standard deviation of a judged height, in logarithms, is the Weber fraction of frequency, 0.18
  to 0.25 (Israr and Tan 2006); `SPREAD` is the standard deviation of its own logarithm among participants. Ours;
- `LEANING`: the standard deviation among participants of what being first adds, in the same unit. Ours;
- `NEARLY`: two heights that differ by less than this part of the discrimination feel the same, where ties are allowed.
  Ours.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from experiment.records.tapping import FIRST, SECOND, TIE
from experiment.rehearsal.participant import SimulatedPerson
from experiment.rehearsal.tapping import surfaces

DISCRIMINATION = 0.25
SPREAD = 0.3
LEANING = 0.05
NEARLY = 0.5

DECIDES_LOG_S = (1.6, 0.35)
"""From both samples laid out to the keyed answer, where they feel far apart: mean and standard deviation of the
logarithm of seconds; median 5 s, and up to twice as long where they feel alike. Ours."""

LAYS_OUT_S = (2.0, 5.0)
"""What the simulated experimenter takes to lay out a pair, s. Ours."""

WORDS = {FIRST: "the first", SECOND: "the second", TIE: "neither"}


@dataclass(kw_only=True)
class SimulatedTapper(SimulatedPerson):
    """Implements `Console`: a participant before two samples, and a simulated experimenter who lays them out."""

    def __post_init__(self) -> None:
        super().__post_init__()
        rng = self._rng(0)
        self._discrimination = DISCRIMINATION * float(np.exp(SPREAD * rng.normal()))
        self._leaning = LEANING * float(rng.normal())
        names = [material.id for material in self.protocol.materials]
        felt_hz = [surfaces.felt_hz(surfaces.rings(hz), surfaces.RATE_HZ) for hz in surfaces.frequencies_hz(names)]
        self._heights = {name: float(np.log(hz or 1.0)) for name, hz in zip(names, felt_hz, strict=True)}
        self._keys = {answer: key for key, answer in self.protocol.comparisons.answers.items()}
        self._laid: tuple[str, ...] = ()
        self._times: Counter[int] = Counter()

    def place(self, *, trial: int, presented: tuple[str, ...]) -> None:
        super().place(trial=trial, presented=presented)
        self._laid = presented
        self._times[trial] += 1
        self.clock.sleep_ns(int(self._rng(trial, self._times[trial], 0).uniform(*LAYS_OUT_S) * 1e9))

    def says(self, trial: int) -> tuple[str, str]:
        rng = self._rng(trial, self._times[trial], 1)
        first, second = (self._heights[name] + self._discrimination * rng.normal() for name in self._laid)
        apart = (first - second) / self._discrimination
        self.clock.sleep_ns(int(rng.lognormal(*DECIDES_LOG_S) * (1 + np.exp(-abs(apart))) * 1e9))
        answer = self._answer(apart + self._leaning / self._discrimination)
        return self._keys[answer], WORDS[answer]

    def _answer(self, apart: float) -> str:
        if TIE in self._keys and abs(apart) < NEARLY:
            return TIE
        return FIRST if apart > 0 else SECOND
