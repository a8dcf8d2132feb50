"""A simulated participant, behind the console's port, with a simulated experimenter at the keys or a real one.

It steps with a foot at the tracker's port, feels what the panel received, and answers with a key. Its `Observer`
feels by the vibration alone: before a task it remembers each real material's spectra at several speeds. In a trial it
compares by equation (6) of Okamoto et al., and the similarity that `designs` judges by falls with dissimilarity. The
parameters are the same for all materials (`experiment/decisions.md`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.desk.questions import Arm, Place, Question, Reply, Rest, Say, TrialAnswer
from palpate.experiment.errors import SessionError, SynthesisError, TrackerError
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.rehearsal.designs import Percept, judge_of
from palpate.experiment.rehearsal.kind import Parts, RehearsalKind
from palpate.experiment.rehearsal.kinds.footstep.recorded_takes import SimulatedMaterials, generic, make_recordings
from palpate.experiment.rehearsal.participant import SimulatedPerson
from palpate.experiment.rehearsal.wires import weight
from palpate.experiment.rehearsal.wires.foot import Foot, Hesitation
from palpate.experiment.rehearsal.wires.panel import CardPanel, Panel
from palpate.experiment.session import scene
from palpate.experiment.session.kinds.footstep.trials import check_force
from palpate.experiment.storage import RECORDINGS
from palpate.experiment.synthesis.spectra import spectrum

if TYPE_CHECKING:
    from palpate.experiment.rehearsal.voice import Speaker

NOTICEABLE = 10 ** (2.5 / 20)
MEMORY_NOISE = 0.06
SENSITIVITY = 5.0
SPREAD = 0.2
CONCURRENCE = 0.7
CONCURRENCE_SPREAD = 0.4

FAMILIAR_SPEEDS_MM_S = (80.0, 150.0, 250.0, 350.0)
FAMILIAR_TAKES = 3

SATURATION_M_S2 = 1e3
"""Far beyond any actuator; nonsensical samples above it feel no stronger."""


@dataclass(frozen=True)
class Bands:
    """Bands into which touch smooths a spectrum.

    `averages` are weights for the bins of each band, shape (B, bins), of bins evenly spaced from 0 Hz; `bins` counts
    each band's, shape (B,).
    """

    averages: NDArray[np.float64]
    bins: NDArray[np.float64]

    def felt(self, amplitudes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the mean magnitude in each band, m/s^2, shape (B,), of a spectrum of shape (bins,)."""
        return self.averages @ np.abs(amplitudes)

    def total(self, felt: NDArray[np.float64]) -> float:
        """Return the sum over all bins of the bands, m/s^2."""
        return float(self.bins @ felt)

    def dissimilarity(self, felt: NDArray[np.float64], remembered: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return equation (6) between smoothed spectra of shapes (..., B): every bin counts, as in the paper."""
        return np.abs(felt - remembered) @ self.bins


def third_octaves(*, bin_hz: float, low_hz: float = 10.0, high_hz: float = 500.0) -> Bands:
    """Return bands of a third of an octave between the two frequencies, without empty ones.

    Raises `SynthesisError` if all are empty, as for takes too short to be felt.
    """
    frequencies_hz = np.arange(int(high_hz / bin_hz) + 1) * bin_hz
    band = np.floor(3 * np.log2(np.maximum(frequencies_hz, bin_hz / 2) / low_hz) + 1e-9).astype(int)
    felt = np.unique(band[frequencies_hz >= low_hz])
    if not felt.size:
        raise SynthesisError(
            "bins",
            f"got {bin_hz:g} Hz wide",
            "make the takes longer",
            allowed=f"one between {low_hz:g} and {high_hz:g} Hz",
        )
    rows = np.array([band == b for b in felt], dtype=np.float64)
    bins = rows.sum(axis=1)
    return Bands(averages=rows / bins[:, None], bins=bins)


class Observer:
    """The touch of a simulated participant, whom `rng` sets apart from others; it knows these `material_ids`."""

    def __init__(self, materials: SimulatedMaterials, material_ids: Sequence[str], *, rng: np.random.Generator) -> None:
        self._materials = materials
        self._ids = tuple(material_ids)
        self._window_s = materials.samples / materials.rate_hz
        self._bands = third_octaves(bin_hz=1 / (2 * self._window_s))
        self._sensitivity = SENSITIVITY * float(np.exp(SPREAD * rng.normal()))
        self._concurrence = CONCURRENCE * float(np.exp(CONCURRENCE_SPREAD * rng.normal()))
        self._remembered: NDArray[np.float64] | None = None

    def familiarise(self, *, rng: np.random.Generator) -> None:
        """Crinkle every material, and step on the bare panel, at several speeds; remember what that felt like."""
        remembered = []
        for material in (None, *self._ids):
            blur = np.exp(MEMORY_NOISE * rng.normal(size=self._bands.bins.size))
            for speed in FAMILIAR_SPEEDS_MM_S:
                takes = [
                    self._felt(self._materials.take(material, speed_mm_s=speed, rng=rng)) for _ in range(FAMILIAR_TAKES)
                ]
                remembered.append(np.mean(takes, axis=0) * blur)
        shape = (1 + len(self._ids), len(FAMILIAR_SPEEDS_MM_S), self._bands.bins.size)
        self._remembered = np.reshape(remembered, shape)

    def feel_real(self, take: NDArray[np.float64], *, speed_mm_s: float) -> Percept:
        """Return what a real cylinder feels like.

        `take` is the panel's acceleration, m/s^2, shape (n,), at the materials' rate. Raises `SessionError` unless
        familiarized.
        """
        return self._compared(self._felt(take), speed_mm_s=speed_mm_s, sensitivity=self._sensitivity)

    def feel_virtual(
        self,
        panel_take: NDArray[np.float64],
        delivered: NDArray[np.float64] | None,
        *,
        rate_hz: int,
        speed_mm_s: float,
    ) -> Percept:
        """Return what a virtual stimulus feels like, together with the bare panel.

        `panel_take` is as in `feel_real`; `delivered` is what the actuator added from contact on, m/s^2, shape (m,), at
        `rate_hz`, None for nothing; samples that are not numbers move nothing. Raises as `feel_real`.
        """
        coefficients = self._coefficients(panel_take, self._materials.rate_hz)
        if delivered is not None:
            moved = np.clip(np.nan_to_num(delivered), -SATURATION_M_S2, SATURATION_M_S2)
            coefficients = coefficients + self._coefficients(moved, rate_hz)
        return self._compared(
            self._bands.felt(coefficients),
            speed_mm_s=speed_mm_s,
            sensitivity=self._sensitivity * self._concurrence,
        )

    def _felt(self, take: NDArray[np.float64]) -> NDArray[np.float64]:
        return self._bands.felt(self._coefficients(take, self._materials.rate_hz))

    def _coefficients(self, samples: NDArray[np.float64], rate_hz: int) -> NDArray[np.float64]:
        """Return the spectrum after contact up to the highest band, whatever rate and length `samples` has."""
        window = np.zeros(round(self._window_s * rate_hz))
        kept = samples[: window.size]
        window[: kept.size] = kept
        below_top = np.zeros(self._bands.averages.shape[1])
        got = spectrum(window)[: below_top.size]
        below_top[: got.size] = got
        return below_top

    def _at_speed(self, speed_mm_s: float) -> NDArray[np.float64]:
        """Return what is remembered of panel and materials, linear between familiar speeds, (1 + M, B)."""
        if self._remembered is None:
            raise SessionError(
                "the simulated participant does not know the materials", remedy="run the familiarization first"
            )
        speeds = FAMILIAR_SPEEDS_MM_S
        lower = int(np.clip(np.searchsorted(speeds, speed_mm_s) - 1, 0, len(speeds) - 2))
        part = (speed_mm_s - speeds[lower]) / (speeds[lower + 1] - speeds[lower])
        between = (1 - part) * self._remembered[:, lower] + part * self._remembered[:, lower + 1]
        return np.maximum(between, 0.0)

    def _compared(self, felt: NDArray[np.float64], *, speed_mm_s: float, sensitivity: float) -> Percept:
        panel, *known_materials = self._at_speed(speed_mm_s)
        if self._bands.total(felt) <= NOTICEABLE * self._bands.total(panel):
            return Percept(np.empty(0))
        templates = np.array(known_materials)
        scale = self._bands.dissimilarity(templates[:, None], templates[None, :]).max()
        dissimilarities = self._bands.dissimilarity(felt, templates) / scale
        return Percept(-sensitivity * dissimilarities)


FELT_TIMEOUT_S = 2.0
"""How long a participant waits for a stimulus before answering, by the wall clock, which paces the trial."""

LATEST_FELT_S = 60.0
"""The same in simulated time, by the machine's clock: a stimulus that was sent comes, however busy the machine is."""

MOST_RESTS = 5
"""Most rests in a row for one zeroing: a busy machine may spoil one or two, a foot too far from contact all."""

SPEED_MEDIAN_MM_S = 180.0
SPEED_SIGMA = 0.35
"""Foot speeds are log-normal about the natural steps of section 3.1: most within 50-300 mm/s."""

IN_VAIN = 0.03
"""Part of the steps that stop or turn back between gate and panel, half of them each."""

READY_S = (0.3, 1.2)
"""From arming to the beginning of a step, s."""

HEARS_S = 0.9
"""From the end of a spoken answer to its key, s: the experimenter listens, and looks at what is proposed."""

BEFORE_SAID_S = 0.4
"""From the experimenter's key to a word that was asked for, s."""

SPEAKS_LOG_S = (0.3, 0.3)
"""From contact to the keyed answer: mean and standard deviation of the logarithm of seconds; median 1.3 s."""


@dataclass(kw_only=True)
class SimulatedParticipant(SimulatedPerson):
    """Implements `Console`: a participant before the panel, and a simulated experimenter at the keys.

    `foot` and `panel` are at the ports' far ends, `panel` None without an actuator. The foot's device was powered at
    the session time `powered_ns`, and streams by the clock if `real_time`. `speaker` says answers, None for none.
    """

    materials: SimulatedMaterials
    foot: Foot
    powered_ns: int
    panel: Panel | CardPanel | None
    actuator_rate_hz: int
    real_time: bool
    speaker: Speaker | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self._observer = Observer(self.materials, tuple(m.id for m in self.protocol.materials), rng=self._own_rng())
        self._observer.familiarise(rng=self._own_rng(1))
        self._under_foot: str | None = None
        self._attempt = 0
        self._lands_later = False
        self._rested = 0
        self._spoken_ns = 0

    def ask(self, question: Question | Arm) -> Reply:
        match question:
            case Say(words=words, why=why):
                self.show(f"Recording {question.take} of {question.takes}: '{words}'{f' ({why})' if why else ''}")
                if self.speaker is not None:
                    self.speaker.say(words, BEFORE_SAID_S)
                    return Reply(question.choices[0].key)
            case Rest(why=why):
                self._rest(why)
        reply = super().ask(question)
        match question:
            case Place(presented=presented):
                (self._under_foot,) = presented
            case Arm(trial=trial, attempt=attempt, broken_off=broken_off):
                if broken_off and self._lands_later:
                    self._attempt, self._lands_later = attempt, False
                else:
                    self._step(trial, attempt)
            case TrialAnswer() if self.speaker is not None:
                self.clock.sleep_ns(self._spoken_ns + int(HEARS_S * 1e9) - self.clock.now_ns())
        return reply

    def _rest(self, why: str) -> None:
        self._rested = self._rested + 1 if why else 1
        if self._rested > MOST_RESTS:
            raise TrackerError(
                f"{why}; the simulated foot rested {MOST_RESTS} times and cannot rest any other way",
                remedy="use a rig and a protocol that match",
            )
        self.show(f"{why or 'Zeroing'}: the foot rests on the panel")
        self.foot.put_down()

    def _step(self, trial: int, attempt: int) -> None:
        self._attempt = attempt
        rng = self._rng(trial, attempt, 0)
        speed_mm_s = float(np.clip(rng.lognormal(np.log(SPEED_MEDIAN_MM_S), SPEED_SIGMA), 55.0, 390.0))
        ready_ns = int(rng.uniform(*READY_S) * 1e9)
        now_ns = self.clock.now_ns()
        begin_ns = max(now_ns + ready_ns, self.powered_ns + self.foot.free_us * 1000)
        if not self.real_time:
            # Simulated time passes nowhere else; a foot that streams by the clock only has to know when.
            self.clock.sleep_ns(begin_ns - now_ns)
        while self.panel is not None and self.panel.felt(0) is not None:
            self.show("The participant felt a stimulus in an attempt that did not count")
        whim = self._rng(trial, attempt, 2)
        in_vain: Hesitation | None = None
        if whim.random() < IN_VAIN:
            in_vain = "stop" if whim.random() < 0.5 else "turn"
        force_n = weight.drawn_n(self.entropy, self._rng(trial, attempt, 3))
        trajectory = replace(self.foot.trajectory(rng, speed_mm_s, in_vain), force_n=force_n)
        self._lands_later = trajectory.hesitation == "dip"
        self.foot.step(trajectory, (begin_ns - self.powered_ns) // 1000)

    def says(self, trial: int) -> tuple[str, str]:
        rng = self._rng(trial, self._attempt, 1)
        speed_mm_s = self.foot.true_speed_mm_s
        take = self.materials.take(self._under_foot, speed_mm_s=speed_mm_s, rng=rng)
        if self._under_foot is not None:
            percept = self._observer.feel_real(take, speed_mm_s=speed_mm_s)
        else:
            timeout_s = FELT_TIMEOUT_S if self.real_time else LATEST_FELT_S
            felt = self.panel.felt(timeout_s) if self.panel is not None else None
            percept = self._observer.feel_virtual(take, felt, rate_hz=self.actuator_rate_hz, speed_mm_s=speed_mm_s)
        judged = judge_of(self.protocol.task(self.who[1]))(self.protocol, [percept], rng)
        self.foot.finish()
        spoken_ns = self.powered_ns + int(self.foot.true_contact_us * 1e3) + int(rng.lognormal(*SPEAKS_LOG_S) * 1e9)
        self.clock.sleep_ns(spoken_ns - self.clock.now_ns())
        if self.speaker is not None:
            self._spoken_ns = self.clock.now_ns() + int(self.speaker.say(judged.words) * 1e9)
        return judged.key, judged.words


def _person(parts: Parts, *, protocol: Protocol, **everybody: Any) -> SimulatedParticipant:
    if parts.foot is None:
        raise RuntimeError("nobody steps without a foot")
    synthesis = protocol.table(Footstep).synthesis
    return SimulatedParticipant(
        **everybody,
        protocol=protocol,
        materials=SimulatedMaterials(synthesis.rate_hz, synthesis.samples),
        foot=parts.foot,
        powered_ns=parts.powered_ns,
        panel=parts.panel,
        actuator_rate_hz=parts.rig.actuator.rate_hz,
        real_time=parts.real_time,
        speaker=parts.speaker,
    )


def _prepare(dataset: Path, protocol: Protocol, seed: int) -> None:
    """Write recordings into a new dataset where its stimuli are made from them."""
    if scene.virtual(protocol).synthesis:
        make_recordings(dataset / RECORDINGS, protocol=protocol, seed=seed)


def _rig(protocol: Protocol) -> str:
    return f"rigs/{'weight' if protocol.table(Footstep).force else 'rehearsal'}.toml"


REHEARSAL = RehearsalKind(_person, generic, _rig, check_force, _prepare)
