"""Rig files: what is read, what is refused and in which words, and what a calibration does."""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Callable
from contextlib import nullcontext
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.audio import calibration as audio_calibration
from palpate.experiment.apparatus.panel import calibration as panel_calibration
from palpate.experiment.apparatus.panel import validity
from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.apparatus.tracker.settings import CalibrationPoint, TrackerRig
from palpate.experiment.errors import ActuatorError, Remedy, RigError, TrackerError
from palpate.experiment.protocol import files as protocols
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import Step
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.synthesis.shaping import Response
from palpate.experiment.synthesis.voltages import Drive
from tests.approved import Refuses
from tests.rig import sites

STEP = Step(gate_top_mm=20.0, gate_bottom_mm=10.0, contact_mm=0.0)

GOOD = """\
format = 1

[rig]
name = "bench 2"
simulated = false

[tracker]
port = "/dev/ttyACM0"
baud = 600_000
rate_hz = 5000
stall_ms = 150
calibration = [
  { counts = 100, mm = 60.0 },
  { counts = 400, mm = 20.0 },
  { counts = 900, mm = -2.0 },
]

[actuator]
driver = "pcm-tcp"
address = "127.0.0.1:4711"
rate_hz = 48000
full_scale_m_s2 = 60.0
"""

Write = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def written(text: str) -> Path:
        path = tmp_path / "rig.toml"
        path.write_text(text, "utf-8")
        return path

    return written


@pytest.fixture(scope="session")
def rehearsal(repository_root: Path) -> Rig:
    return rigs.load(repository_root / "protocols" / "rigs" / "rehearsal.toml")


def test_a_rig_is_read(write: Write) -> None:
    rig = rigs.load(write(GOOD))
    assert (rig.rig.name, rig.rig.simulated) == ("bench 2", False)
    assert (tracker_of(rig).rate_hz, tracker_of(rig).calibration[1]) == (5000, CalibrationPoint(counts=400, mm=20.0))
    assert rig.actuator.address == "127.0.0.1:4711"


def test_a_key_that_is_too_young_is_read_once_the_format_that_is_named_stands_where_the_old_one_did(
    write: Write,
) -> None:
    pedal = '[pedal]\nport = "/dev/ttyACM1"\nbaud = 9600\ntried_on = 2026-11-21\ntried_days = 30\n'
    text = f"{shipped('rigs/laboratory.toml').read_text('utf-8')}\n{pedal}"
    with pytest.raises(RigError) as refused:
        rigs.load(write(text))
    # It stands below remarks: whoever wrote another on the first line would have two.
    (number,) = re.findall(r"write format = (\d+)$", refused.value.findings[0].allowed)
    assert rigs.load(write(re.sub("(?m)^format = .*", f"format = {number}", text))).pedal is not None


@pytest.mark.parametrize(
    ("line", "instead", "problem"),
    [
        (
            "rate_hz = 5000",
            "rate_hz = 9000",
            "line 10: tracker.rate_hz: got 9000; allowed: a whole number at least 1000",
        ),
        ("stall_ms = 150", "stall_ms = 250", "line 11: tracker.stall_ms: got 250; allowed: .* at most 200"),
        ("baud = 600_000", "baud = 599_999", "line 9: tracker.baud: got 599999; allowed: at least 600000"),
        ("counts = 400", "counts = 100", "line 14: .*counts: got 100; allowed: more than at the previous point"),
        ("mm = -2.0", "mm = 20.0", "line 15: .*mm: got 20.0; allowed: less than at the previous point"),
        ("mm = -2.0", "mm = 70.0", "line 15: .*mm: got 70.0; allowed: less than at the previous point"),
        ("mm = -2.0", "mm = nan", "line 15: .*mm: got nan; allowed: a number"),
        ("4711", "471100", "line 20: actuator.address: got '127.0.0.1:471100'; allowed: host:port"),
        ("4711", "70000", "line 20: actuator.address: got .*; allowed: host:port with a port from 1 to 65535"),
        ("127.0.0.1:4711", "rehearsal", "line 20: .*got 'rehearsal'; allowed: a real address"),
        ("/dev/ttyACM0", "rehearsal", "line 8: tracker.port: got 'rehearsal'; allowed: a real port"),
        (
            'driver = "pcm-tcp"',
            'driver = "jack"',
            "line 19: actuator.driver: .*; allowed: pcm-tcp, audio, or package.module",
        ),
        ("[rig]", "[rigg]", "line 3: rigg: got a table; allowed: no such key; did you mean 'rig'"),
        ("format = 1", "format = ", "line 1: column 10"),
    ],
)
def test_a_wrong_value_is_named_with_its_line_and_what_is_allowed(
    write: Write, line: str, instead: str, problem: str
) -> None:
    assert line in GOOD
    with pytest.raises(RigError, match=problem):
        rigs.load(write(GOOD.replace(line, instead)))


SHAPING = """
[actuator.shaping]
response = "bench-2.csv"
response_sha256 = "0000000000000000000000000000000000000000000000000000000000000000"
full_scale_v = 9.0
gain_limit_v_per_m_s2 = 2.5
"""
VOLTS = GOOD.replace("full_scale_m_s2 = 60.0\n", "") + SHAPING


def test_a_device_takes_accelerations_or_volts(write: Write) -> None:
    accelerations, volts = rigs.load(write(GOOD)).actuator, rigs.load(write(VOLTS)).actuator
    assert (accelerations.full_scale, accelerations.shaping) == (60.0, None)
    assert (volts.full_scale, volts.full_scale_m_s2) == (9.0, None)
    assert volts.shaping is not None
    assert volts.shaping.response == "bench-2.csv"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (GOOD + SHAPING, r"line 22: actuator\.full_scale_m_s2: got 60\.0; allowed: .*exactly one of them"),
        (
            GOOD.replace("full_scale_m_s2 = 60.0\n", ""),
            r"actuator\.full_scale_m_s2: got nothing; allowed: .*exactly one",
        ),
        (GOOD + "high_hz = 600.0\n", r"low_hz: got nothing; allowed: both low_hz and high_hz, or neither"),
        (
            GOOD + "low_hz = 10.0\nhigh_hz = 9.0\n",
            r"high_hz: got 9\.0; allowed: a number greater than low_hz \(10\.0\)",
        ),
        (
            VOLTS.replace("[actuator.shaping]", "low_hz = 10.0\nhigh_hz = 600.0\n[actuator.shaping]"),
            r"low_hz: got 10\.0; allowed: no low_hz or high_hz with \[actuator\.shaping\]",
        ),
        (
            VOLTS.replace("bench-2.csv", "../bench-2.csv"),
            r"shaping\.response: got .*; allowed: the name of a \.csv file in",
        ),
        (
            VOLTS.replace("bench-2.csv", ""),
            r"shaping\.response: got ''; allowed: the name of a \.csv file in the folder",
        ),
        (VOLTS.replace("0000", "xxxx"), r"shaping\.response_sha256: got .*; allowed: 64 hexadecimal digits"),
        (
            VOLTS.replace("full_scale_v = 9.0\n", ""),
            r"shaping\.full_scale_v: got nothing; allowed: a number greater than 0",
        ),
        (
            VOLTS.replace("= 2.5", "= 0.0"),
            r"shaping\.gain_limit_v_per_m_s2: got 0\.0; allowed: a number greater than 0",
        ),
        (VOLTS.replace("= 2.5", "= inf"), r"shaping\.gain_limit_v_per_m_s2: got inf; allowed: a number greater than 0"),
        (VOLTS.replace("full_scale_v", "full_scale"), r"shaping\.full_scale: .*did you mean 'full_scale_v'"),
    ],
)
def test_what_is_wrong_with_volts_is_named(write: Write, text: str, problem: str) -> None:
    with pytest.raises(RigError, match=problem):
        rigs.load(write(text))


def test_another_measurement_of_the_response_is_another_rig(write: Write) -> None:
    before = rigs.sha256(rigs.load(write(VOLTS)))
    assert rigs.sha256(rigs.load(write(VOLTS.replace("0000", "1111", 1)))) != before


def test_shaping_is_opened_for_volts_and_for_nothing_else(write: Write, refuses: Refuses) -> None:
    drive = Drive(
        {},
        rate_hz=48_000,
        response=Response(np.array([10.0, 20.0]), np.array([1.0]), np.ones((2, 1))),
        gain_limit_v_per_m_s2=1.0,
    )
    with refuses(RigError):
        opening.open_actuator(rigs.load(write(VOLTS)), limit_m_s2=10.0)
    with refuses(RigError):
        opening.open_actuator(rigs.load(write(GOOD)), limit_m_s2=10.0, drive=drive)
    with socket.create_server(("127.0.0.1", 0)) as server:
        where = f"127.0.0.1:{server.getsockname()[1]}"
        threading.Thread(target=lambda: server.accept()[0].close(), daemon=True).start()
        opened = opening.open_actuator(rigs.load(write(VOLTS)), limit_m_s2=10.0, drive=drive, address=where)
    assert opened.rate_hz == 48_000


def test_a_file_without_an_actuator_is_shown_a_line_that_will_do(write: Write) -> None:
    """It has a tracker alone, which is to be calibrated."""
    without = re.sub(r"(?ms)^\[actuator\].*?(?=^\[|\Z)", "", GOOD)
    with pytest.raises(RigError) as refused:
        rigs.load(write(without))
    (problem,) = (one for one in str(refused.value).splitlines() if "actuator: got nothing" in one)
    assert rigs.load(write(problem.partition("above the tables: ")[2] + "\n" + without)).actuator.rate_hz == 5000


def test_every_problem_is_reported_at_once_one_a_line(write: Write) -> None:
    text = GOOD.replace("stall_ms = 150", "stall_ms = 250").replace("mm = 20.0", "mm = 60.0").replace("4711", "0")
    with pytest.raises(RigError, match="3 errors") as caught:
        rigs.load(write(text))
    assert [line.split(":")[0].strip() for line in str(caught.value).splitlines()[1:]] == [
        "line 11",
        "line 14",
        "line 20",
    ]


def test_a_missing_file_is_an_error_that_says_so(tmp_path: Path) -> None:
    with pytest.raises(RigError, match="no such file"):
        rigs.load(tmp_path / "rig.toml")


def test_the_hash_is_that_of_the_rig_and_not_of_its_file(write: Write) -> None:
    rig = rigs.load(write(GOOD))
    reworded = "# bench\n" + GOOD.replace("600_000", "600000").replace("60.0", "6e1")
    assert rigs.sha256(rigs.load(write(reworded))) == rigs.sha256(rig)
    assert rigs.sha256(rigs.load(write(GOOD.replace("mm = 20.0", "mm = 20.1")))) != rigs.sha256(rig)
    assert len(rigs.sha256(rig)) == 64


def test_copies_of_a_rig_file_are_one_rig_each_in_a_folder_of_its_own(tmp_path: Path) -> None:
    files = [tmp_path / name / "rig.toml" for name in "ab"]
    for file in files:
        file.parent.mkdir()
        file.write_bytes(shipped("rigs/rehearsal.toml").read_bytes())
    first, second = (rigs.load(file) for file in files)
    assert rigs.sha256(first) == rigs.sha256(second)
    assert [first.folder, second.folder] == [file.parent for file in files]


def test_the_rehearsals_rig_serves_the_published_gate(rehearsal: Rig) -> None:
    assert rehearsal.rig.simulated
    rigs.check(rehearsal, STEP)
    counts = np.arange(64, 4096)
    assert np.max(np.diff(tracker_of(rehearsal).height_mm(counts))) < 0.03


@pytest.mark.parametrize(("line", "instead"), [("mm = 60.0", "mm = 24.9"), ("mm = -2.0", "mm = -0.9")])
def test_a_calibration_must_reach_past_gate_and_panel(write: Write, line: str, instead: str, refuses: Refuses) -> None:
    rigs.check(rigs.load(write(GOOD)), STEP)
    with refuses(RigError):
        rigs.check(rigs.load(write(GOOD.replace(line, instead))), STEP)


def test_zeroing_asks_for_a_calibration_that_reaches_further(write: Write) -> None:
    def zeroed(calibrated: str) -> Rig:
        return rigs.load(write(calibrated.replace("[tracker]", "[tracker]\nzeroing_mm = 3.0")))

    wide = GOOD.replace("mm = -2.0", "mm = -4.0").replace("mm = 60.0", "mm = 28.0")
    rigs.check(zeroed(wide), STEP)
    for narrow in (wide.replace("-4.0", "-3.9"), wide.replace("28.0", "27.9")):
        with pytest.raises(RigError, match=r"this protocol needs -4 to 28 mm"):
            rigs.check(zeroed(narrow), STEP)


def test_a_reading_between_points_lies_on_a_straight_line_and_none_beyond_them_is_extrapolated(write: Write) -> None:
    tracker = tracker_of(rigs.load(write(GOOD)))
    counts = np.array([0, 99, 100, 250, 400, 650, 900, 901, 65535])
    assert tracker.height_mm(counts).tolist() == pytest.approx([60, 60, 60, 40, 20, 9, -2, -2, -2])


@given(st.data())
def test_counts_are_the_inverse_of_heights_to_half_a_count(data: st.DataObject) -> None:
    size = data.draw(st.integers(2, 6))
    counts = sorted(data.draw(st.sets(st.integers(0, 65535), min_size=size, max_size=size)))
    mm = sorted(
        data.draw(st.sets(st.integers(-20, 200), min_size=size, max_size=size)), reverse=data.draw(st.booleans())
    )
    tracker = TrackerRig(
        port="x",
        baud=1_000_000,
        rate_hz=1000,
        stall_ms=200,
        calibration=tuple(CalibrationPoint(counts=c, mm=float(h)) for c, h in zip(counts, mm, strict=True)),
    )
    readings = np.arange(counts[0], counts[-1] + 1)
    heights = tracker.height_mm(readings)
    assert np.array_equal(tracker.counts(heights), readings)
    assert np.all(np.diff(heights) < 0) or np.all(np.diff(heights) > 0)


TRACKER = GOOD[GOOD.index("[tracker]") : GOOD.index("[actuator]")]
PUSHES = """
[servo]
address = "127.0.0.1:4712"
driver = "force-tcp"
full_scale_n = 5.0
damping_n_s_m = 2.0
delay_ms = 0.0
answer_ms = 1.0
"""


def test_a_rig_of_format_5_may_have_no_tracker(write: Write, refuses: Refuses) -> None:
    rig = rigs.load(write(GOOD.replace(TRACKER, "").replace("format = 1", "format = 5")))
    assert rig.driver_files == ()
    with refuses(RigError):
        rigs.check(rig, STEP)


@pytest.mark.parametrize("text", [GOOD, GOOD.replace("format = 1", "format = 5") + PUSHES], ids=["format 1", "servo"])
def test_a_tracker_is_missed_where_a_hand_is_pushed_and_in_earlier_formats(write: Write, text: str) -> None:
    with pytest.raises(RigError) as raised:
        rigs.load(write(text.replace(TRACKER, "")))
    (problem,) = raised.value.findings
    assert problem.field == "tracker"


def test_simulated_ports_exist_only_in_a_rehearsal(rehearsal: Rig, refuses: Refuses) -> None:
    with refuses(TrackerError):
        opening.open_tracker(rehearsal, clock=ManualClock(0))
    with refuses(ActuatorError):
        opening.open_actuator(rehearsal, limit_m_s2=10.0)


def test_the_date_of_a_rig_file_that_nobody_calibrated_is_told_as_that() -> None:
    audio = rigs.load(shipped("rigs/laboratory.toml")).audio
    assert audio is not None
    for calibrated in (audio.latency, audio.headphones):
        with pytest.raises(RigError, match=r"got 2000-01-01, the placeholder date of an uncalibrated rig file"):
            rigs.check_age(calibrated, date(2026, 5, 4))


STOPS = rigs.StopsRig(emergency="a switch", limit="a fuse", tried_on=date(2026, 5, 1), tried_days=30)
SERVO = rigs.load(shipped("rigs/tapping.toml")).servo


@pytest.mark.parametrize(
    ("changed", "peak_m_s2", "today", "refused"),
    [
        # 60 m/s^2 at full scale.
        ({}, 60.0, date(2026, 5, 4), False),
        ({}, None, date(2026, 5, 4), False),
        ({}, 59.0, date(2026, 5, 4), True),
        ({"servo": SERVO}, None, date(2026, 5, 4), True),
        ({"servo": SERVO, "rig": rigs.Identity(name="none", simulated=True)}, 59.0, date(2026, 5, 4), False),
        ({"servo": SERVO, "stops": STOPS}, 59.0, date(2026, 5, 31), False),
        ({"servo": SERVO, "stops": STOPS}, 59.0, date(2026, 6, 1), True),
        ({"servo": SERVO, "stops": STOPS}, 59.0, date(2026, 4, 30), True),
    ],
)
def test_a_real_rig_that_could_hurt_names_its_stops_and_when_they_were_tried(
    write: Write, changed: dict[str, object], peak_m_s2: float | None, today: date, refused: bool
) -> None:
    rig = rigs.load(write(GOOD)).model_copy(update=changed)
    with pytest.raises(RigError) if refused else nullcontext():
        rigs.check_stops(rig, {} if peak_m_s2 is None else {None: peak_m_s2}, today)


@pytest.mark.parametrize(
    ("limits_m_s2", "refused"),
    [
        # 40 m/s^2 at full scale at the palm and 25 at the wrist; the actuator of no site takes volts.
        ({"palm": 40.0, "wrist": 25.0}, False),
        ({"palm": 39.0, "wrist": 25.0}, True),
        ({"palm": 40.0, "wrist": 24.0}, True),
        ({"palm": 40.0}, False),
        ({None: 40.0}, True),
    ],
)
def test_stops_are_needed_for_the_sites_of_a_study_each_by_its_own_limit(
    tmp_path: Path, limits_m_s2: dict[str | None, float], refused: bool
) -> None:
    rig = rigs.load(sounding(tmp_path)).model_copy(update={"rig": rigs.Identity(name="none", simulated=False)})
    with pytest.raises(RigError) if refused else nullcontext():
        rigs.check_stops(rig, limits_m_s2, date(2026, 5, 4))


def test_stops_came_with_the_second_format_and_make_no_other_rig(write: Write) -> None:
    stops = '\n[stops]\nemergency = "a switch"\nlimit = "a fuse"\ntried_on = 2026-05-01\ntried_days = 30\n'
    with pytest.raises(RigError) as refused:
        rigs.load(write(GOOD + stops))
    assert "stops" in str(refused.value)
    newer = GOOD.replace("format = 1", "format = 2")
    rig = rigs.load(write(newer + stops))
    assert rig.stops == STOPS
    assert rigs.sha256(rig) == rigs.sha256(rigs.load(write(newer)))


def sounding(folder: Path, change: tuple[str, str] = ("", ""), since: str = "[[sites]]") -> Path:
    """The rig of `sites`, with one change in its text from a table on."""
    path = sites.card_rig(folder)
    text = path.read_text("utf-8")
    at = text.index(since)
    path.write_text(text[:at] + text[at:].replace(*change, 1), "utf-8")
    return path


def test_a_rig_has_each_site_as_its_only_actuator(tmp_path: Path) -> None:
    rig = rigs.load(sounding(tmp_path))
    palm, wrist = rig.at("palm"), rig.at("wrist")
    assert rig.at(None) == rig
    assert list(rig.views) == [None, "palm", "wrist"]
    assert (palm.actuator.full_scale_m_s2, wrist.actuator.full_scale_m_s2) == (40.0, 25.0)
    each = [own.audio.channels for own in rig.views.values() if own.audio is not None]
    assert [(one.actuator, one.loopback) for one in each] == [(3, 2), (4, 3), (3, 2)]
    assert opening.open_channels(rig) == (4, 3)
    assert palm.folder == tmp_path
    with pytest.raises(RigError) as raised:
        rig.at("toe")
    assert raised.value.finding.allowed == "palm, wrist"


@pytest.mark.parametrize(
    ("limits_m_s2", "ceilings"),
    [
        # Accelerations go up to the limit of their own site: 6 of 40, and 12 of 25.
        ({"palm": 6.0, "wrist": 12.0}, (0.0, 0.0, 0.48, 0.15)),
        ({"palm": 6.0}, (0.0, 0.0, 0.0, 0.15)),
        ({"wrist": 12.0}, (0.0, 0.0, 0.48, 0.0)),
        # Volts behind a response go up to full scale.
        ({None: 10.0}, (0.0, 0.0, 1.0, 0.0)),
    ],
)
def test_a_session_opens_the_outputs_of_its_sites_alone_each_up_to_its_limit(
    tmp_path: Path, limits_m_s2: dict[str | None, float], ceilings: tuple[float, ...]
) -> None:
    rig = rigs.load(sounding(tmp_path))
    settings = opening.session_stream(rig, limits_m_s2=limits_m_s2, listens=False, masker=None)
    assert settings.ceilings == pytest.approx(ceilings)
    assert settings.inputs == 3


def test_a_session_ends_by_the_slowest_output_that_it_uses(tmp_path: Path) -> None:
    rig = rigs.load(sounding(tmp_path, ("output_ms = 2.667", "output_ms = 8.0")))
    for site, output_ms in (("palm", 8.0), ("wrist", 2.667)):
        settings = opening.session_stream(rig, limits_m_s2={site: 6.0}, listens=False, masker=None)
        assert settings.output_ms == output_ms


def test_a_study_limits_the_sites_that_its_stimuli_name(tmp_path: Path) -> None:
    study = tmp_path / "study.toml"
    study.write_text(sites.sited(1), "utf-8")
    assert protocols.load(study).limits_m_s2 == {"palm": 6.0, "wrist": 12.0}
    plain = protocols.load(shipped("presented.toml"))
    assert plain.limits_m_s2 == {None: plain.exposure.vibration_peak_m_s2}


def test_a_site_is_part_of_the_rig_that_a_session_records(tmp_path: Path) -> None:
    before = rigs.sha256(rigs.load(sounding(tmp_path)))
    assert rigs.sha256(rigs.load(sounding(tmp_path, ("full_scale_m_s2 = 40.0", "full_scale_m_s2 = 41.0")))) != before


def test_the_address_of_a_sites_actuator_is_no_part_of_it(tmp_path: Path) -> None:
    path = sounding(tmp_path)
    text = path.read_text("utf-8").replace('driver = "audio"', 'driver = "pcm-tcp"\naddress = "127.0.0.1:4711"')
    at = text.index("[[sites]]")
    own = re.sub(r"(?s)channel = .*?(?=\[sites\.actuator\])", "", text[at:])
    path.write_text(text[:at] + own, "utf-8")
    before = rigs.sha256(rigs.load(path))
    path.write_text(text[:at] + own.replace(":4711", ":4712", 1), "utf-8")
    assert rigs.sha256(rigs.load(path)) == before


def test_a_site_is_named_by_what_calibrates_it(tmp_path: Path) -> None:
    rig = rigs.load(sounding(tmp_path))
    palm = rig.at("palm")
    assert palm.audio is not None
    with pytest.raises(RigError) as raised:
        rigs.check_age(palm.audio.latency, date(2027, 5, 4), palm.site)
    assert "palm" in str(raised.value.finding.where)
    assert isinstance(raised.value.finding.remedy, Remedy)
    assert raised.value.finding.remedy.command[-2:] == ("--site", "palm")
    real = palm.model_copy(update={"rig": rigs.Identity(name="none", simulated=False)})
    found = validity.unmeasured_panel(tmp_path / "rig.toml", real, date(2026, 5, 4))
    assert found is not None
    assert isinstance(found.remedy, Remedy)
    assert found.remedy.command[-2:] == ("--site", "palm")


def test_the_remark_of_one_actuator_leaves_with_its_calibration_and_no_other(tmp_path: Path) -> None:
    late, unmeasured = "  # NOT CALIBRATED: `palpate calibrate audio`", "  # NOT MEASURED: `palpate calibrate actuator`"
    text = sounding(tmp_path).read_text("utf-8").replace(".latency]", f".latency]{late}")
    text = re.sub(r"(?m)^(full_scale_m_s2 = \S+)", rf"\1{unmeasured}", text)
    assert (text.count(late), text.count(unmeasured)) == (3, 2)
    for site, head in (("palm", "loopback = 3\n\n[sites.latency]"), (None, "[audio.latency]")):
        after = audio_calibration.rewritten(text, {"output_ms": "3.5"}, site)
        assert f"{head}\noutput_ms = 3.5\n" in after
        assert after.count(late) == 2
    found = {"full_scale_m_s2": 49.7, "low_hz": 12.0, "high_hz": 600.0, "load": "nobody"}
    after = panel_calibration.rewritten(text, found, "palm")
    assert f"full_scale_m_s2 = 25.0{unmeasured}" in after
    assert after.count(unmeasured) == 1


def test_each_site_has_a_response_table_of_its_own() -> None:
    names = {panel_calibration.table_beside(Path("rig.toml"), site).name for site in (None, "palm", "left wrist")}
    assert names == {"rig-panel.csv", "rig-palm-panel.csv", "rig-left-wrist-panel.csv"}


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (('name = "palm"', 'name = "wrist"'), "sites[1].name"),
        (("channel = 4", "channel = 3"), "sites[1].channel"),
        (("channel = 4", "channel = 2"), "sites[0].channel"),
        (("loopback = 3", "loopback = 1"), "sites[0].loopback"),
        (("loopback = 3\n", ""), "sites[0].loopback"),
        (("channel = 4\n", ""), "sites[0].channel"),
        (("rate_hz = 48000", "rate_hz = 44100"), "sites[0].actuator.rate_hz"),
        (('driver = "audio"', 'driver = "pcm-tcp"\naddress = "127.0.0.1:4711"'), "sites[0].actuator.driver"),
    ],
)
def test_what_is_wrong_with_a_site_is_named(tmp_path: Path, change: tuple[str, str], field: str) -> None:
    with pytest.raises(RigError) as raised:
        rigs.load(sounding(tmp_path, change))
    assert field in {one.field for one in raised.value.findings}


def test_a_sensor_stays_on_no_rig_of_several_sites(tmp_path: Path) -> None:
    sensor = '[accelerometer]\ndriver = "pcm-tcp"\naddress = "127.0.0.1:4712"\nrate_hz = 5000\n'
    sensor += "full_scale_m_s2 = 200\ntrigger_m_s2 = 1\nstays = {}\n\n[[sites]]"
    rigs.load(sounding(tmp_path, ("[[sites]]", sensor.format("false"))))
    with pytest.raises(RigError) as raised:
        rigs.load(sounding(tmp_path, ("[[sites]]", sensor.format("true"))))
    assert [one.field for one in raised.value.findings] == ["accelerometer.stays"]


def test_a_site_without_a_loopback_is_heard_by_none(tmp_path: Path) -> None:
    path = sounding(tmp_path, ("loopback = 3\n", ""))
    text = path.read_text("utf-8")
    path.write_text(text.replace(sites.LATENCY, "", 1), "utf-8")
    own = rigs.load(path).at("palm").audio
    assert own is not None
    assert own.channels.loopback is None
