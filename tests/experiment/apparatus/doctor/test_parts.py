"""What checks make of what they measured: reads that come late, rates, streams with gaps; limits as printed."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus import rig
from palpate.experiment.apparatus.audio.stream import Fit, StreamHealth
from palpate.experiment.apparatus.display import ScreenRig
from palpate.experiment.apparatus.doctor import checks, devices
from palpate.experiment.apparatus.doctor.devices import Heard
from palpate.experiment.apparatus.rig import ShapingRig, tracker_of
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.tracker.frames import LinkCounts
from palpate.experiment.errors import Finding
from palpate.experiment.protocol.files import shipped

RIG = rig.load(shipped("rigs/headless.toml"))


def heard(device_us: np.ndarray, delay_ms: list[float], drift_ppm: float = 0.0) -> Heard:
    return Heard(
        device_us, np.zeros(device_us.size), np.array(delay_ms), LinkCounts(device_us.size), ClockMap(0, 0, drift_ppm)
    )


@pytest.mark.parametrize(
    ("late_ms", "verdict"),
    [([1.0] * 999 + [200.0], "passes"), ([1.0] * 98 + [11.0] * 2, "refuses"), ([1.0] * 999 + [201.0], "refuses")],
)
def test_reads_that_come_late_are_red(late_ms: list[float], verdict: str) -> None:
    assert devices.arrival(heard(np.arange(2), late_ms), tracker_of(RIG)).verdict == verdict


@pytest.mark.parametrize(("ppm", "told"), [(1e4, "+10000"), (-1e4, "-10000")])
def test_a_clock_beyond_what_a_map_believes_is_told_as_that_and_no_delay_is_judged_by_it(
    ppm: float, told: str, approved: SnapshotAssertion
) -> None:
    strayed = heard(np.arange(2), [-438.0] * 100, ppm)
    found, arrived = devices.drift(strayed), devices.arrival(strayed, tracker_of(RIG))
    assert found.verdict == "refuses"
    assert arrived.verdict == "unknown"
    assert [found.what, arrived.what] == approved
    near = heard(np.arange(2), [1.0] * 100, 9_999.0)
    assert [devices.drift(near).verdict, devices.arrival(near, tracker_of(RIG)).verdict] == ["passes", "passes"]


def table_of(folder: Path, comments: str, *, simulated: bool) -> Finding:
    content = f"{comments}frequency_hz,drive_vrms,acceleration_pp_m_s2\n10,0.1,0.1\n20,0.1,0.2\n".encode()
    (folder / "t.csv").write_bytes(content)
    shaping = ShapingRig(
        response="t.csv",
        response_sha256=hashlib.sha256(content).hexdigest(),
        full_scale_v=12.0,
        gain_limit_v_per_m_s2=4.0,
    )
    of = RIG.model_copy(
        update={
            "rig": RIG.rig.model_copy(update={"simulated": simulated}),
            "actuator": RIG.actuator.model_copy(update={"shaping": shaping}),
        }
    )
    found = checks.table(of, folder)
    assert found is not None
    return found


def test_a_real_rig_has_no_simulated_response_and_of_a_nameless_one_nobody_knows(
    tmp_path: Path, approved: SnapshotAssertion
) -> None:
    simulated = "# SIMULATED response.\n"
    red = table_of(tmp_path, simulated, simulated=False)
    assert red.verdict == "refuses"
    assert red.clause() == approved
    assert table_of(tmp_path, simulated, simulated=True).verdict == "passes"
    # Where it says so is one.
    assert table_of(tmp_path, f"# {'Long. ' * 50}\n{simulated}", simulated=False).verdict == "refuses"
    assert table_of(tmp_path, "# 4 May 2026, with a foot of 1 kg.\n", simulated=False).verdict == "passes"
    nameless = table_of(tmp_path, "", simulated=False)
    assert nameless.verdict == "unknown"
    assert nameless.remedy == approved


def test_lost_frames_do_not_change_the_rate() -> None:
    found = devices.rate(heard(np.delete(1000 * np.arange(1000), [10, 11, 12, 500]), []), tracker_of(RIG))
    assert found.verdict == "passes"
    assert found.what.startswith("1000.0 Hz")


@pytest.mark.parametrize(
    ("spread_mm", "stated_mm", "verdict"), [(0.0, 0.03, "refuses"), (0.03, 0.03, "passes"), (0.0, 0.0, "passes")]
)
def test_a_sensor_that_says_the_same_in_every_frame_is_stuck(spread_mm: float, stated_mm: float, verdict: str) -> None:
    settings = tracker_of(RIG).model_copy(update={"noise_mm": stated_mm})
    height_mm = 70.0 + np.random.default_rng(1).normal(0.0, spread_mm, 1000)
    found = devices.noise(replace(heard(1000 * np.arange(1000), []), height_mm=height_mm), settings)
    assert found.verdict == verdict
    assert ("stuck" in str(found.remedy)) == (verdict == "refuses")


@pytest.mark.parametrize(
    ("along_mm", "verdict"), [(0.0, "passes"), (29.9, "passes"), (-30.0, "refuses"), (30.0, "refuses")]
)
def test_a_planar_sensor_at_the_end_of_its_calibration_along_the_face_is_red(along_mm: float, verdict: str) -> None:
    tapping = tracker_of(rig.load(shipped("rigs/tapping.toml")))
    (found,) = devices.along(replace(heard(np.arange(3), []), along_mm=np.full(3, along_mm)), tapping)
    assert (found.check, found.verdict) == ("tracker along", verdict)
    assert re.findall(r"-?\d+\.\d+", found.what) == ["0.000", f"{along_mm:.1f}"]
    assert found.allowed == "-30 to 30 mm"
    assert devices.along(heard(np.arange(3), []), tracker_of(RIG)) == ()


def test_one_sample_is_no_rate() -> None:
    assert devices.rate(heard(np.arange(1), []), tracker_of(RIG)).verdict == "refuses"


@pytest.mark.parametrize(("drift_ppm", "verdict"), [(-9999.0, "passes"), (10_000.0, "refuses"), (-10_000.0, "refuses")])
def test_a_clock_at_the_end_of_what_is_believed_is_red(drift_ppm: float, verdict: str) -> None:
    assert devices.drift(heard(np.arange(2), [], drift_ppm)).verdict == verdict


@pytest.mark.parametrize(
    ("drift_ppm", "more", "said"),
    [
        (499.0, "", ""),
        (-5000.0, "", "; typical of a resonator instead of a crystal: foot speeds are off by 0.5 %"),
        (10_000.0, " or more", ""),
    ],
)
def test_a_resonators_drift_is_green_with_a_word(drift_ppm: float, more: str, said: str) -> None:
    found = devices.drift(heard(np.arange(2), [], drift_ppm))
    assert found.what == f"drift {drift_ppm:+.0f} ppm{more} relative to this machine's clock over 0.0 s{said}"


@pytest.mark.parametrize(
    ("gaps", "xruns", "exact", "verdict"),
    [
        (0, 0, False, "passes"),
        (0, 1, False, "refuses"),
        (0, 1, True, "passes"),
        (1, 0, True, "refuses"),
        (1, 1, False, "refuses"),
    ],
)
def test_a_stream_with_gaps_or_xruns_is_red(gaps: int, xruns: int, exact: bool, verdict: str) -> None:
    assert RIG.audio is not None
    # What was before the watching, 2 xruns and 3 gaps, does not count.
    since = StreamHealth(48_000, 2, 3, Fit(0.0, 0.0, 0.0))
    until = StreamHealth(96_000, 2 + xruns, 3 + gaps, Fit(0.0, 0.0, 0.0))
    found = devices.health(since, until, RIG.audio, exact=exact)[0]
    assert (found.verdict, found.what) == (verdict, f"1.0 s: gaps: {gaps}, xruns: {xruns}")


@pytest.mark.parametrize(("median_ms", "verdict"), [(0.66, "passes"), (0.67, "refuses")])
def test_callbacks_later_than_a_quarter_of_a_block_are_red(median_ms: float, verdict: str) -> None:
    assert RIG.audio is not None
    # 128 frames at 48 kHz are 2.667 ms, a quarter 0.6667 ms.
    since = StreamHealth(0, 0, 0, Fit(0.0, 0.0, 0.0))
    until = StreamHealth(48_000, 0, 0, Fit(median_ms, 5.0, 9.0))
    assert devices.health(since, until, RIG.audio, exact=False)[1].verdict == verdict


def test_stops_are_asked_to_be_tried_and_a_participant_without_a_key_is_told() -> None:
    tried = rig.StopsRig(emergency="a switch", limit="a fuse", tried_on=date(2026, 5, 1), tried_days=30)
    real = RIG.model_copy(update={"rig": rig.Identity(name="real", simulated=False), "screen": None})
    known = real.model_copy(update={"stops": tried, "screen": ScreenRig()})
    for one, day, verdicts in (
        (RIG.model_copy(update={"screen": None}), 2, ["unknown"]),
        (real, 2, ["refuses", "unknown"]),
        (known, 2, ["passes", "passes"]),
        (known, 30, ["passes", "passes"]),
    ):
        assert [check.verdict for check in checks.stops(one, {None: 30.0}, date(2026, 5, day))] == verdicts
