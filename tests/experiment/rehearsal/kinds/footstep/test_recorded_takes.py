"""Simulated materials and sessions: crackling noise as described, Table 3 on average, one way to draw takes."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.validation import validate
from palpate.experiment.errors import RecordingError, SynthesisError
from palpate.experiment.protocol.files import load as load_protocol
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.recordings.manifest import load, load_all
from palpate.experiment.recordings.store import Condition, Plan, plan
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
from palpate.experiment.rehearsal.kinds.footstep.recorded_takes import (
    CRACKLES,
    Course,
    SimulatedMaterials,
    crackle_of,
    generic,
    make_recordings,
    power_law_energies,
    pulses,
)
from palpate.experiment.rehearsal.kinds.footstep.recorder import fresh_takes
from palpate.experiment.synthesis.signals.dissimilarity import dissimilarity
from palpate.experiment.synthesis.spectra import spectrum
from tests.approved import Refuses
from tests.reference.okamoto2012 import TABLE_3

MATERIALS = SimulatedMaterials(rate_hz=5000, samples=2500)


@pytest.fixture(scope="module")
def protocol(repository_root: Path) -> Protocol:
    return load_protocol(repository_root / "protocols" / "okamoto2012.toml")


def test_the_parameters_alone_give_table_3_on_average() -> None:
    """Without choosing among sessions: the mean over 40 of them, each three takes as in section 6.1."""
    f = np.arange(501.0)
    sums = dict.fromkeys(TABLE_3, 0.0)
    for seed in range(40):
        rng = np.random.default_rng((99, seed))
        panel = np.abs(spectrum([MATERIALS.take(None, speed_mm_s=200, rng=rng) for _ in range(3)])).mean(axis=0)
        own = {}
        for material in CRACKLES:
            takes = [MATERIALS.take(material, speed_mm_s=200, rng=rng) for _ in range(3)]
            own[material] = np.maximum(np.abs(spectrum(takes)).mean(axis=0) - panel, 0)[:501]
        scores = {(a, b): float(dissimilarity(own[a], own[b], frequencies_hz=f)) for a, b in TABLE_3}
        for pair, score in scores.items():
            sums[pair] += score / max(scores.values()) / 40
    assert sums == {pair: pytest.approx(printed, abs=0.012) for pair, printed in TABLE_3.items()}


def test_a_seed_gives_the_same_bytes_and_another_seed_others(tmp_path: Path, protocol: Protocol) -> None:
    contents = []
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        make_recordings(tmp_path / name, protocol=protocol, seed=seed)
        contents.append({path.name: path.read_bytes() for path in (tmp_path / name).iterdir()})
    assert contents[0] == contents[1]
    assert contents[0] != contents[2]


def test_recordings_are_labelled_simulated(tmp_path: Path, protocol: Protocol) -> None:
    manifest = make_recordings(tmp_path, protocol=protocol, seed=0)
    made = load(tmp_path, synthesis=protocol.table(Footstep).synthesis, material_ids=["copy paper"])
    assert made.simulated
    assert "SIMULATED" in made.label
    said = manifest.read_text(encoding="utf-8")
    number = recorded_takes.session(plan(protocol, source=recorded_takes.source(0), simulated=True), seed=0).number
    assert f"seed 0, session {number}, " in said
    assert "within 0.018 of Table 3" in said
    assert "is not evidence" in said
    assert len(list(tmp_path.glob("*.wav"))) == (4 + 1) * 4 * 3


def test_other_conditions_than_the_papers_are_recorded_without_the_table(tmp_path: Path, protocol: Protocol) -> None:
    other = protocol.table(Footstep).synthesis.model_copy(update={"rate_hz": 4000, "samples": 800, "takes": 1})
    make_recordings(
        tmp_path,
        protocol=protocol.model_copy(
            update={"footstep": protocol.table(Footstep).model_copy(update={"synthesis": other})}
        ),
        seed=0,
    )
    assert load(tmp_path, synthesis=other, material_ids=["polypropylene"]).panel.shape == (4, 1, 800)
    said = (tmp_path / "manifest.toml").read_text(encoding="utf-8")
    assert "session 0; materials fitted" in said


def test_a_material_of_another_id_is_simulated_generically_and_its_manifest_says_so(
    tmp_path: Path, protocol: Protocol, approved: SnapshotAssertion
) -> None:
    cork, felt = (protocol.materials[0].model_copy(update={"id": one}) for one in ("cork", "felt"))
    told = []
    for name, materials in (("one", (*protocol.materials[1:], cork)), ("two", (cork, felt))):
        manifest = make_recordings(
            tmp_path / name, protocol=protocol.model_copy(update={"materials": materials}), seed=0
        )
        told.append(manifest.read_text("utf-8"))
    assert [line for text in told for line in text.splitlines() if "is generic" in line] == approved
    assert generic(CRACKLES) == ""


def test_generic_materials_follow_from_their_ids_and_differ_and_the_papers_are_as_they_were() -> None:
    assert all(crackle_of(material) is crackle for material, crackle in CRACKLES.items())
    assert crackle_of("cork") == crackle_of("cork") != crackle_of("felt")
    spectra = [
        np.abs([spectrum(MATERIALS.take(one, speed_mm_s=200, rng=np.random.default_rng(n))) for n in range(20)]).mean(0)
        for one in ("cork", "cork ", "felt")
    ]
    strays = [np.abs(a - b).sum() / spectra[0].sum() for a, b in pairwise(spectra)]
    assert min(strays) > 0.1


def test_no_session_that_meets_the_table_is_an_error_not_a_loop(
    tmp_path: Path, protocol: Protocol, monkeypatch: pytest.MonkeyPatch, refuses: Refuses
) -> None:
    monkeypatch.setattr(recorded_takes, "TABLE_3_TOLERANCE", 0.0)
    monkeypatch.setattr(recorded_takes, "MOST_SESSIONS", 3)
    with refuses(RecordingError):
        make_recordings(tmp_path, protocol=protocol, seed=0)


@pytest.mark.parametrize("material", [*CRACKLES, "cork", "felt", "素材"])
def test_accelerations_have_a_plausible_size_and_rise_with_speed(material: str) -> None:
    rng = np.random.default_rng(3)
    peaks = [
        np.median([np.abs(MATERIALS.take(material, speed_mm_s=v, rng=rng)).max() for _ in range(15)])
        for v in (50, 100, 200, 300)
    ]
    assert peaks == sorted(peaks)
    assert 1 < peaks[2] < 20


def test_a_take_with_an_object_holds_the_panels_thump(monkeypatch: pytest.MonkeyPatch) -> None:
    """With pulses too weak to matter, what is left is the bare panel's take, 10 mm later: 0.05 s at 200 mm/s."""
    silent = {name: dataclasses.replace(c, pulses_per_s=1e-9) for name, c in CRACKLES.items()}
    monkeypatch.setattr(recorded_takes, "CRACKLES", silent)
    still = SimulatedMaterials(rate_hz=5000, samples=2500)
    take = still.take("copy paper", speed_mm_s=200, rng=np.random.default_rng(1))
    assert not take[:250].any() or np.abs(take[:250]).max() < 1e-12
    loudest = np.abs(take).max()
    assert loudest == pytest.approx(
        np.abs(still.take(None, speed_mm_s=200, rng=np.random.default_rng(2))).max(), rel=0.5
    )


@pytest.mark.parametrize("exponent", sorted({c.exponent for c in CRACKLES.values()}))
def test_energies_follow_the_power_law(exponent: float) -> None:
    """Closed form of the truncated power law: P(E > x) at x = 10, and the bounds."""
    energies = power_law_energies(exponent=exponent, size=40_000, rng=np.random.default_rng(4))
    g = 1 - exponent
    expected = (10**g - 1e4**g) / (1 - 1e4**g)
    assert np.mean(energies > 10) == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / 40_000))
    assert energies.min() >= 1
    assert energies.max() <= 1e4
    assert 1.3 <= exponent <= 1.6  # Houle and Sethna 1996


def test_pulses_are_poisson_with_the_expected_course() -> None:
    """Steady at 1000/s for 0.1 s, then dying with 0.2 s: 100 + 200 (1 - exp(-2)) in 0.5 s, variance equal to mean."""
    course = Course(rate_per_s=1000, crush_s=0.1, relaxation_s=0.2, window_s=0.5)
    rng = np.random.default_rng(5)
    times = [course.times_s(rng) for _ in range(400)]
    counts = np.array([t.size for t in times])
    mean = 100 + 200 * (1 - np.exp(-2))
    assert course.expected == pytest.approx(mean)
    assert counts.mean() == pytest.approx(mean, abs=4 * np.sqrt(mean / 400))
    assert counts.var() / mean == pytest.approx(1, abs=4 * np.sqrt(2 / 400))
    early = np.mean(np.concatenate(times) < 0.1)
    assert early == pytest.approx(100 / mean, abs=0.01)


def test_takes_of_one_course_have_one_energy() -> None:
    """The power-law tail moves energy from pulse to pulse, not from take to take."""
    course = Course(rate_per_s=500, crush_s=0.1, relaxation_s=0.2, window_s=0.5)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        # So fine a grid that no two pulses fall into one sample.
        made = pulses(course=course, exponent=1.4, rate_hz=10_000_000, samples=5_000_000, rng=rng)
        assert np.sum(made**2) == pytest.approx(course.expected, rel=1e-3)


def test_no_pulse_is_silence() -> None:
    course = Course(rate_per_s=1e-9, crush_s=0.1, relaxation_s=0.2, window_s=0.5)
    assert not pulses(course=course, exponent=1.4, rate_hz=100, samples=50, rng=np.random.default_rng(0)).any()


@pytest.mark.parametrize("speed", [1e-300, 1.0, 19.9, 55.0, 390.0, 10_000.0])
def test_any_speed_of_a_leg_gives_finite_takes(speed: float) -> None:
    rng = np.random.default_rng(6)
    assert np.all(np.isfinite(MATERIALS.take("typing paper", speed_mm_s=speed, rng=rng)))
    assert np.all(np.isfinite(MATERIALS.take(None, speed_mm_s=speed, rng=rng)))


@pytest.mark.parametrize("speed", [0.0, -1.0, np.nan, np.inf])
def test_other_speeds_are_refused(speed: float) -> None:
    for material in ("copy paper", None):
        with pytest.raises(SynthesisError, match="speed_mm_s: got"):
            MATERIALS.take(material, speed_mm_s=speed, rng=np.random.default_rng(0))


@pytest.fixture(scope="module")
def planned(protocol: Protocol) -> Plan:
    return plan(protocol, source=recorded_takes.source(1), simulated=True)


@pytest.mark.parametrize("seed", range(1, 21))
def test_at_least_half_of_the_takes_are_close_for_every_material(planned: Plan, seed: int) -> None:
    """Okamoto et al., section 3.3: "the same or close speed levels", "for all types of materials"."""
    recorded = recorded_takes.session(planned, seed=seed).recordings()
    found = validate.compute(recorded, fresh_takes(recorded, seed=seed))
    assert {one.material: 2 * int(one.close.sum()) >= one.takes for one in found.classified} == dict.fromkeys(
        planned.materials, True
    )


def test_attempts_are_the_same_in_whatever_order_they_are_asked_for(planned: Plan) -> None:
    one, other = (recorded_takes.RecordingSession(planned, seed=3, number=2) for _ in range(2))
    conditions = planned.conditions()[:3]
    there = [one.attempt(c, 2).samples_m_s2 for c in conditions]
    back = [other.attempt(c, 2).samples_m_s2 for c in reversed(conditions)]
    np.testing.assert_array_equal(there, back[::-1])


def test_no_two_attempts_sessions_seeds_or_plans_share_a_draw(planned: Plan) -> None:
    condition = Condition("copy paper", 100.0, 1)
    longer = Plan(**{**vars(planned), "takes": planned.takes + 1})
    drawn = [
        recorded_takes.RecordingSession(p, seed=seed, number=number).attempt(condition, attempt).speed_mm_s
        for p in (planned, longer)
        for seed in (1, 2)
        for number in (0, 1)
        for attempt in (1, 2)
    ]
    assert len(set(drawn)) == 16


def test_speeds_are_those_of_a_foot_that_aims(planned: Plan) -> None:
    """Log-normal about the target: of 1000 attempts the mean log is within 4 standard errors of it."""
    drawn = recorded_takes.RecordingSession(planned, seed=1, number=0)
    target = Condition(None, 200.0, 1)
    logs = np.log([drawn.attempt(target, n).speed_mm_s / 200 for n in range(1, 1001)])
    assert logs.mean() == pytest.approx(0, abs=4 * recorded_takes.AIM_SIGMA / np.sqrt(1000))
    assert logs.std() == pytest.approx(recorded_takes.AIM_SIGMA, rel=0.1)


def test_recordings_on_disk_are_the_sessions_kept_takes(tmp_path: Path, planned: Plan, protocol: Protocol) -> None:
    recorded_takes.make_recordings(tmp_path, protocol=protocol, seed=1)
    drawn = recorded_takes.session(planned, seed=1).recordings()
    for on_disk, kept in zip(load_all(tmp_path).objects.values(), drawn.objects.values(), strict=True):
        np.testing.assert_array_equal(on_disk, kept.astype(np.float32))
