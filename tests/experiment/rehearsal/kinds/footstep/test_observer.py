"""The simulated participant judges the waveform: published confusions with it, chance without it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment.errors import SessionError, SynthesisError
from palpate.experiment.rehearsal.designs import Percept
from palpate.experiment.rehearsal.designs.identification import judge
from palpate.experiment.rehearsal.kinds.footstep.participant import Observer, third_octaves
from palpate.experiment.rehearsal.kinds.footstep.recorded_takes import SimulatedMaterials
from palpate.experiment.synthesis.crinkle import CrinkleSpectra, subtract
from palpate.experiment.synthesis.waveforms import prepare
from tests.approved import Refuses
from tests.reference.okamoto2012 import MATERIALS as IDS
from tests.reference.okamoto2012 import TABLE_1, TABLE_2

MATERIALS = SimulatedMaterials(rate_hz=5000, samples=2500)
SPEEDS = (50.0, 100.0, 200.0, 300.0)
OUTPUT_HZ = 5000

Delivered = NDArray[np.float64] | None
Deliver = Callable[[int, float, np.random.Generator], Delivered]


def spectra(seed: int) -> list[CrinkleSpectra]:
    """Of recordings as a session makes them, three takes each."""
    rng = np.random.default_rng((1, seed))
    bare = [[MATERIALS.take(None, speed_mm_s=v, rng=rng) for _ in range(3)] for v in SPEEDS]
    return [
        subtract(
            speeds_mm_s=SPEEDS,
            rate_hz=5000,
            panel_object_takes=[[MATERIALS.take(material, speed_mm_s=v, rng=rng) for _ in range(3)] for v in SPEEDS],
            panel_takes=bare,
        )
        for material in IDS
    ]


def answered(felt: Percept, rng: np.random.Generator, ids: Sequence[str] = IDS) -> str:
    """Return the material that is named in an identification of these."""
    study = SimpleNamespace(materials=[SimpleNamespace(key=one, spoken=(one,)) for one in ids])
    return judge(cast("Any", study), [felt], rng).words


def foot(rng: np.random.Generator) -> float:
    return float(np.clip(rng.lognormal(np.log(180), 0.3), 80, 350))


def virtual(deliver: Deliver, *, participants: int, seed: int) -> NDArray[np.float64]:
    """Mean confusion matrix of 40 trials a participant."""
    matrix = np.zeros((4, 4))
    for participant in range(participants):
        rng = np.random.default_rng((2, seed, participant))
        observer = Observer(MATERIALS, IDS, rng=rng)
        observer.familiarise(rng=rng)
        for presented in np.repeat(range(4), 10):
            v = foot(rng)
            panel = MATERIALS.take(None, speed_mm_s=v, rng=rng)
            delivered = deliver(int(presented), v, rng)
            felt = observer.feel_virtual(panel, delivered, rate_hz=OUTPUT_HZ, speed_mm_s=v)
            matrix[presented, IDS.index(answered(felt, rng))] += 1
    return matrix / (10 * participants)


def real(*, participants: int, seed: int) -> NDArray[np.float64]:
    matrix = np.zeros((4, 4))
    for participant in range(participants):
        rng = np.random.default_rng((3, seed, participant))
        observer = Observer(MATERIALS, IDS, rng=rng)
        observer.familiarise(rng=rng)
        for presented in np.repeat(range(4), 10):
            v = foot(rng)
            take = MATERIALS.take(IDS[presented], speed_mm_s=v, rng=rng)
            matrix[presented, IDS.index(answered(observer.feel_real(take, speed_mm_s=v), rng))] += 1
    return matrix / (10 * participants)


def stimuli(seed: int, *, shift: int = 0) -> Deliver:
    """The stimulus of the material presented, or of the one `shift` places further."""
    known = [prepare(one, material="any", output_rate_hz=OUTPUT_HZ) for one in spectra(seed)]

    def deliver(presented: int, v: float, rng: np.random.Generator) -> Delivered:
        return known[(presented + shift) % 4].at(v).waveform_m_s2

    return deliver


def correlation(matrix: NDArray[np.float64], printed: Sequence[Sequence[float]]) -> float:
    return float(np.corrcoef(matrix.ravel(), np.ravel(printed))[0, 1])


def chance_bounds(trials: int) -> float:
    """Four standard errors of an accuracy at chance."""
    return float(4 * np.sqrt(0.25 * 0.75 / trials))


@pytest.mark.parametrize("seed", range(3))
def test_virtual_confusions_are_those_of_table_1(seed: int) -> None:
    matrix = virtual(stimuli(seed), participants=15, seed=seed)
    assert correlation(matrix, TABLE_1) >= 0.85


@pytest.mark.parametrize("seed", range(3))
def test_real_confusions_are_those_of_table_2(seed: int) -> None:
    assert correlation(real(participants=10, seed=seed), TABLE_2) >= 0.95


def test_real_materials_are_told_apart_better_than_virtual_ones() -> None:
    assert np.trace(real(participants=20, seed=9)) > np.trace(virtual(stimuli(9), participants=20, seed=9))


@pytest.mark.parametrize(
    "deliver",
    [
        lambda presented, v, rng: None,
        lambda presented, v, rng: np.zeros(2500),
        lambda presented, v, rng: rng.normal(scale=3.0, size=2500),
        lambda presented, v, rng: np.full(2500, np.nan),
    ],
    ids=["nothing", "silence", "noise", "not a number"],
)
def test_a_waveform_that_says_nothing_leaves_chance(deliver: Deliver) -> None:
    accuracy = np.trace(virtual(deliver, participants=15, seed=4)) / 4
    assert accuracy == pytest.approx(0.25, abs=chance_bounds(600))


def test_silence_gives_every_answer_alike() -> None:
    answered = virtual(lambda presented, v, rng: None, participants=15, seed=5).mean(axis=0)
    assert answered == pytest.approx([0.25] * 4, abs=chance_bounds(600))


def test_a_stimulus_that_is_compared_with_no_material_gives_no_answer() -> None:
    with pytest.raises(SessionError):
        answered(Percept(strength=1.0), np.random.default_rng(1))


def test_answers_follow_the_waveform_and_not_the_material_presented() -> None:
    right = virtual(stimuli(6), participants=10, seed=6)
    swapped = virtual(stimuli(6, shift=2), participants=10, seed=6)
    assert correlation(np.roll(swapped, 2, axis=0), right.tolist()) > 0.9
    assert np.trace(swapped) / 4 < 0.25


def one(seed: int = 7) -> Observer:
    observer = Observer(MATERIALS, IDS, rng=np.random.default_rng(seed))
    observer.familiarise(rng=np.random.default_rng(seed + 1))
    return observer


def test_the_same_chance_gives_the_same_answers() -> None:
    take = MATERIALS.take("aluminum foil", speed_mm_s=150, rng=np.random.default_rng(1))
    answers = [
        [answered(one().feel_real(take, speed_mm_s=150), np.random.default_rng(seed)) for seed in range(12)]
        for _ in range(2)
    ]
    assert answers[0] == answers[1]
    assert len(set(answers[0])) > 1


@pytest.mark.parametrize("rate_hz", [1200, 5000, 44_100, 48_000])
def test_the_rate_of_the_actuator_does_not_matter(rate_hz: int) -> None:
    """Copy paper is loud: whatever the rate, it is named far more often than chance."""
    observer = one()
    made = prepare(spectra(8)[0], material="any", output_rate_hz=rate_hz).at(150).waveform_m_s2
    named = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        panel = MATERIALS.take(None, speed_mm_s=150, rng=rng)
        named += answered(observer.feel_virtual(panel, made, rate_hz=rate_hz, speed_mm_s=150), rng) == "copy paper"
    assert named >= 20


@pytest.mark.parametrize(
    "garbage",
    [
        np.array([]),
        np.array([np.inf, -np.inf, np.nan]),
        np.full(10, 1e308),
        np.full(1_000_000, 5.0),
        np.full(3, 1e-320),
    ],
    ids=["empty", "infinite", "huge", "too long", "tiny"],
)
def test_garbage_still_gets_an_answer(garbage: NDArray[np.float64]) -> None:
    rng = np.random.default_rng(0)
    panel = MATERIALS.take(None, speed_mm_s=100, rng=rng)
    assert answered(one().feel_virtual(panel, garbage, rate_hz=OUTPUT_HZ, speed_mm_s=100), rng) in IDS


@pytest.mark.parametrize("speed", [1.0, 55.0, 390.0, 2000.0])
def test_any_speed_gets_an_answer(speed: float) -> None:
    rng = np.random.default_rng(0)
    take = MATERIALS.take("polypropylene", speed_mm_s=speed, rng=rng)
    assert answered(one().feel_real(take, speed_mm_s=speed), rng) in IDS


def test_bands_hold_every_bin_from_10_to_500_hz_once() -> None:
    bands = third_octaves(bin_hz=1.0)
    held = (bands.averages > 0).sum(axis=0)
    assert held[:10].tolist() == [0] * 10
    assert held[10:].tolist() == [1] * 491
    np.testing.assert_allclose(bands.averages.sum(axis=1), 1.0)
    lowest = [int(np.flatnonzero(row)[0]) for row in bands.averages]
    assert lowest[:4] == [10, 13, 16, 20]  # 10 x 2^(n/3): 10, 12.6, 15.9, 20


def test_smoothing_keeps_equation_6_between_even_spectra() -> None:
    bands = third_octaves(bin_hz=1.0)
    quiet, loud = np.full(501, 1.0), np.full(501, 3.0)
    assert float(bands.dissimilarity(bands.felt(loud), bands.felt(-quiet))) == pytest.approx(2.0 * 491)


def test_nobody_answers_before_meeting_the_materials() -> None:
    stranger = Observer(MATERIALS, IDS, rng=np.random.default_rng(0))
    with pytest.raises(SessionError, match="familiarization"):
        answered(stranger.feel_real(np.zeros(2500), speed_mm_s=100), np.random.default_rng(0))


@pytest.mark.parametrize(
    "ids", [list("vwxyz"), ["cork", "felt", "moss", "sand", "snow"], [f"素材{n}" for n in range(5)]]
)
def test_five_materials_of_any_ids_are_told_apart_above_chance(ids: list[str]) -> None:
    rng = np.random.default_rng(5)
    observer = Observer(MATERIALS, ids, rng=rng)
    observer.familiarise(rng=rng)
    presented = ids * 20
    takes = [(MATERIALS.take(one, speed_mm_s=200, rng=rng), one) for one in presented]
    right = sum(answered(observer.feel_real(take, speed_mm_s=200), rng, ids) == one for take, one in takes)
    assert right / len(takes) > 1 / 5 + chance_bounds(len(takes))


def test_takes_too_short_to_feel_are_refused(refuses: Refuses) -> None:
    with refuses(SynthesisError):
        Observer(SimulatedMaterials(rate_hz=5000, samples=2), IDS, rng=np.random.default_rng(0))
