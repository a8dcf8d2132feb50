"""The tracker's firmware on a simulated board, read by the real reader through a pseudo-terminal."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.tracker.frames import LinkCounts, Samples
from palpate.experiment.apparatus.tracker.gate import Contact, Gate, GateDetector
from palpate.experiment.apparatus.tracker.serial_tracker import SerialTracker
from palpate.experiment.apparatus.tracker.settings import CalibrationPoint, TrackerRig
from palpate.experiment.errors import TrackerStopped
from palpate.experiment.protocol.models import Step
from palpate.experiment.rehearsal.wires.foot import trajectory
from tests.rig import board
from tests.rig.board import Board, Events

STEP = Step(gate_top_mm=20.0, gate_bottom_mm=10.0, contact_mm=0.0)
WRAP_US = 2**32

# The potentiometer: 40 mV/mm, the panel at 400 mV. simavr's converter gives floor(mV * 1023 / 5000).
MV_PER_MM = 40.0
PANEL_MV = 400.0
CALIBRATION = (CalibrationPoint(counts=0, mm=-10.0), CalibrationPoint(counts=1023, mm=115.0))
TOO_LOW_MM = 5000 / 1023 / MV_PER_MM + 0.5 / MV_PER_MM
TOO_HIGH_MM = 0.5 / MV_PER_MM
"""How far a reading may lie from the height: a count is cut off, and the wiper's voltage rounded to whole mV."""

FLASH_BYTES = 32_768 - 512
"""Of an ATmega328P beside the bootloader of a board."""

OTHER_DEVICES = """
format = 1
rig = { name = "board", simulated = false }
actuator = { driver = "pcm-tcp", address = "127.0.0.1:4711", rate_hz = 5000, full_scale_m_s2 = 64.0 }
"""

RAM_BYTES = 2048
STACK_BYTES = 512


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return board.host(tmp_path_factory.mktemp("host"))


@dataclass(frozen=True)
class Run:
    """What the reader got, and what happened on the chip."""

    device_us: NDArray[np.int64]
    height_mm: NDArray[np.float64]
    counts: NDArray[np.int64]
    link: LinkCounts
    events: Events


RunBoard = Callable[..., Run]


def settings_of(rate_hz: int = 1000, baud: int = 1_000_000) -> TrackerRig:
    rig = TrackerRig(port="board", baud=baud, rate_hz=rate_hz, stall_ms=200, calibration=CALIBRATION)
    # The board's clock is the simulator's, which a busy machine may keep waiting.
    return rig.model_copy(update={"stall_ms": 60_000})


@pytest.fixture
def run(program: Path, tmp_path: Path) -> RunBoard:
    def go(
        us: NDArray[np.float64],
        height_mm: NDArray[np.float64],
        *,
        run_us: float,
        behind_us: float = 5000,
        falling: bool = False,
        **settings: int,
    ) -> Run:
        """Run the firmware while the foot follows straight lines between these heights.

        The last frames, those of `behind_us`, may be under way at the end.
        """
        rate_hz = settings.setdefault("RATE_HZ", 1000)
        volts_mv = PANEL_MV + height_mm * MV_PER_MM
        firmware = board.built(tmp_path / "build", **settings)
        last_us = settings.get("CLOCK_START_US", 0) + run_us - behind_us
        rig = settings_of(rate_hz=rate_hz, baud=settings.get("BAUD", 1_000_000))
        with Board(
            program, firmware, tmp_path, us=us, volts_mv=5000 - volts_mv if falling else volts_mv, run_us=run_us
        ) as chip:
            tracker = SerialTracker(chip.port, rig)
            try:
                chip.go()
                read = [tracker.read()]
                while read[-1].device_us[-1] < last_us:
                    read.append(tracker.read())
                link = tracker.counts
            finally:
                tracker.close()
            chip.unplug()
            events = chip.events()
        height = np.concatenate([samples.height_mm for samples in read])
        return Run(
            device_us=np.concatenate([samples.device_us for samples in read]),
            height_mm=height,
            counts=rig.counts(height),
            link=link,
            events=events,
        )

    return go


def steps(*speeds_mm_s: float, rest_mm: float = 40.0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Steps at constant speed from rest to the panel, and up again; microseconds and mm."""
    us, mm = [0.0], [rest_mm]
    for speed in speeds_mm_s:
        for wait_us, height_mm in ((100_000.0, rest_mm), (rest_mm / speed * 1e6, 0.0), (1e5, 0.0), (1e5, rest_mm)):
            us.append(us[-1] + wait_us)
            mm.append(height_mm)
    return np.array(us), np.array(mm)


@pytest.mark.parametrize(
    ("rate_hz", "run_us", "clock_start_us"),
    [
        (1000, 5e6, 0),
        (2000, 5e6, 0),
        # 70,000 samples: sequence numbers wrap.
        (5000, 14e6, 0),
        # The clock wraps after 2 s.
        (1000, 5e6, WRAP_US - 2_000_000),
    ],
)
def test_no_sample_is_lost_or_late(run: RunBoard, rate_hz: int, run_us: float, clock_start_us: int) -> None:
    period_us = 1_000_000 // rate_hz
    us, height_mm = steps(100, 200, 300, 400)
    got = run(us, height_mm, run_us=run_us, RATE_HZ=rate_hz, CLOCK_START_US=clock_start_us)
    count = got.device_us.size
    assert count >= (run_us - 5000) / period_us
    assert got.link == LinkCounts(received=count)
    assert got.device_us[0] == clock_start_us
    assert set(np.diff(got.device_us)) == {period_us}
    # simavr starts a conversion after the instruction that is under way, of up to four cycles.
    late_us = got.events.converted_us[:count] - (got.device_us - clock_start_us)
    assert np.all(np.abs(late_us) <= 4 / board.CYCLES_US)
    # Each frame carries the reading of its own moment.
    assert np.array_equal(got.counts, got.events.volts_mv[:count] * 1023 // 5000)
    true_mm = np.interp(got.device_us - clock_start_us + got.events.first_us, us, height_mm)
    off_mm = got.height_mm - true_mm
    # A foot at 400 mm/s moves 10^-4 mm in the quarter of a microsecond above.
    assert off_mm.min() > -TOO_LOW_MM - 1e-4
    assert off_mm.max() <= TOO_HIGH_MM + 1e-4
    assert got.events.asleep > 0.25


@pytest.mark.parametrize("speed_mm_s", [60.0, 150.0, 300.0])
@pytest.mark.parametrize("rate_hz", [1000, 5000])
def test_speed_and_contact_are_the_foots(run: RunBoard, rate_hz: int, speed_mm_s: float) -> None:
    foot = trajectory(np.random.default_rng(int(speed_mm_s)), speed_mm_s, hesitation="none")
    got = run(foot.us, foot.height_mm, run_us=foot.duration_us, RATE_HZ=rate_hz)
    detector = GateDetector(STEP)
    _, events = detector.step(
        detector.init(), Samples(got.device_us, got.height_mm, b"", np.zeros(got.device_us.size, dtype=np.int64), 0)
    )
    gate, contact = events
    assert isinstance(gate, Gate)
    assert isinstance(contact, Contact)

    descent = foot.us <= foot.contact_us
    us, mm = foot.us[descent], foot.height_mm[descent]
    speeds_mm_s = np.gradient(mm, us) * 1e6
    # A line between two samples lies off a curve by at most a T^2 / 8.
    bent_mm = float(np.abs(np.gradient(speeds_mm_s, us) * 1e6).max()) / rate_hz**2 / 8

    def passes_us(level_mm: float) -> float:
        return float(np.interp(-level_mm, -mm, us))

    def between_us(level_mm: float) -> tuple[float, float]:
        return passes_us(level_mm + TOO_LOW_MM + bent_mm), passes_us(level_mm - TOO_HIGH_MM - bent_mm)

    (top_from, top_to), (bottom_from, bottom_to) = between_us(20.0), between_us(10.0)
    assert top_from <= gate.top_us + got.events.first_us <= top_to
    assert bottom_from <= gate.bottom_us + got.events.first_us <= bottom_to
    assert 1e7 / (bottom_to - top_from) <= gate.speed_mm_s <= 1e7 / (bottom_from - top_to)

    # Contact is the root of a line through the samples from 3 to 0.5 mm, each of which may lie off by TOO_LOW_MM.
    fitted = np.interp(np.arange(0, foot.contact_us, 1e6 / rate_hz), us, mm)
    fitted_s = np.arange(0, foot.contact_us, 1e6 / rate_hz)[(fitted > 0.5) & (fitted <= 3.0)] / 1e6
    away_s = fitted_s - fitted_s.mean()
    slopes = away_s / (away_s**2).sum()
    at_contact = 1 / away_s.size + slopes * (foot.contact_us / 1e6 - fitted_s.mean())
    landing = mm <= 3.0
    v = float(np.abs(speeds_mm_s[landing]).min())
    a = float(np.abs(np.gradient(speeds_mm_s, us)[landing] * 1e6).max())
    slowest = v - TOO_LOW_MM * np.abs(slopes).sum()
    bound_s = TOO_LOW_MM * np.abs(at_contact).sum() / slowest + 3.0**2 * a / (7 * v**3)
    assert abs(contact.us + got.events.first_us - foot.contact_us) <= bound_s * 1e6


@pytest.mark.parametrize("falling", [False, True])
def test_the_lamp_is_lit_after_a_step_of_the_speed_asked_for(run: RunBoard, falling: bool) -> None:
    us, height_mm = steps(150, 200, 260)
    levels = {"GATE_TOP_COUNTS": 777, "GATE_BOTTOM_COUNTS": 859} if falling else {}
    got = run(us, height_mm, run_us=2.4e6, falling=falling, LAMP_MS=200, **levels)
    passed_us = us[6] - 10 / 200 * 1e6
    (lit_us, lit), (out_us, still_lit) = got.events.lamp
    assert (lit, still_lit) == (True, False)
    # The next sample, its conversion and the main loop; the level is set to the nearest count, the reading cut.
    off_us = (TOO_LOW_MM + 1 / 8) / 200 * 1e6
    assert passed_us - off_us < lit_us < passed_us + off_us + 1000 + 500
    # It goes out with the first sample after its time.
    assert 0 <= out_us - lit_us - 200_000 + 100 < 1000 + 200


def test_the_next_step_puts_the_lamp_out(run: RunBoard) -> None:
    us, height_mm = steps(200, 260)
    got = run(us, height_mm, run_us=1.2e6, LAMP_MS=5000)
    assert [lit for _, lit in got.events.lamp] == [True, False]
    assert got.events.lamp[1][0] == pytest.approx(us[6] - 10 / 260 * 1e6, abs=3000)


def test_no_step_lights_no_lamp(run: RunBoard) -> None:
    # Into the gate and out again, and a landing that began inside it.
    us = np.array([0.0, 1e5, 2e5, 3e5, 4e5, 5e5])
    height_mm = np.array([40.0, 40.0, 12.0, 15.0, 0.0, 0.0])
    dipped = run(
        us, np.array([40.0, 40.0, 12.0, 40.0, 40.0, 40.0]), run_us=5e5, LAMP_SLOWEST_MM_S=1, LAMP_FASTEST_MM_S=9999
    )
    assert dipped.events.lamp == []
    began = run(us, np.minimum(height_mm, 15.0), run_us=5e5, LAMP_SLOWEST_MM_S=1, LAMP_FASTEST_MM_S=9999)
    assert began.events.lamp == []


def test_a_line_that_is_too_slow_loses_whole_frames_and_says_how_many(run: RunBoard) -> None:
    # 125 kbaud just carry 1000 frames a second, but simavr gives every byte an eleventh bit.
    us, height_mm = steps(200)
    got = run(us, height_mm, run_us=3e6, behind_us=50_000, RATE_HZ=1000, BAUD=125_000)
    assert got.link.damaged == 0
    assert got.link.lost > 0
    assert got.link.received + got.link.lost == got.device_us[-1] // 1000 + 1
    sample = got.device_us // 1000
    assert np.array_equal(got.counts, got.events.volts_mv[sample] * 1023 // 5000)


def test_a_board_that_is_unplugged_is_noticed(program: Path, tmp_path: Path) -> None:
    firmware = board.built(tmp_path / "build", RATE_HZ=1000)
    with Board(program, firmware, tmp_path, us=np.zeros(1), volts_mv=np.full(1, 900.0), run_us=5e4) as chip:
        tracker = SerialTracker(chip.port, settings_of())
        try:
            chip.go()
            while tracker.read().device_us[-1] < 45_000:
                pass
            chip.unplug()
            with pytest.raises(TrackerStopped, match="port has disappeared"):
                while True:
                    tracker.read()
        finally:
            tracker.close()


@pytest.mark.parametrize("rate_hz", [1000, 5000])
def test_it_fits_into_the_chip(tmp_path: Path, rate_hz: int) -> None:
    firmware = board.built(tmp_path, RATE_HZ=rate_hz)
    printed = subprocess.run(["avr-size", firmware], capture_output=True, text=True, check=True).stdout
    text, data, bss = (int(word) for word in printed.splitlines()[1].split()[:3])
    print(f"{rate_hz} Hz: {text + data} bytes of flash, {data + bss} of RAM")
    assert text + data <= FLASH_BYTES
    assert data + bss <= RAM_BYTES - STACK_BYTES


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"RATE_HZ": 500}, "RATE_HZ: allowed are 1000"),
        ({"RATE_HZ": 1500}, "RATE_HZ: allowed are 1000"),
        ({"RATE_HZ": 10_000}, "RATE_HZ: allowed are 1000"),
        ({"F_CPU": 8_000_000, "RATE_HZ": 5000}, "F_CPU: allowed are whole megahertz"),
        ({"BAUD": 115_200}, "BAUD: allowed is what divides F_CPU / 8"),
        ({"BAUD": 500_000, "RATE_HZ": 5000}, "BAUD: at least 120 times RATE_HZ"),
        ({"GATE_TOP_COUNTS": 164}, "GATE_TOP_COUNTS, GATE_BOTTOM_COUNTS: allowed are"),
        ({"GATE_TOP_COUNTS": 1024}, "GATE_TOP_COUNTS, GATE_BOTTOM_COUNTS: allowed are"),
        ({"LAMP_SLOWEST_MM_S": 300}, "LAMP_SLOWEST_MM_S, LAMP_FASTEST_MM_S: at least"),
        ({"LAMP_MS": 0}, "LAMP_MS: allowed are"),
    ],
)
def test_settings_that_cannot_work_are_refused(tmp_path: Path, settings: dict[str, int], message: str) -> None:
    done = board.make(tmp_path, **settings)
    assert done.returncode != 0
    assert message in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_rig_file_that_the_readme_shows_is_one(tmp_path: Path) -> None:
    text = (board.FIRMWARE / "README.md").read_text()
    (shown,) = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    file = tmp_path / "rig.toml"
    file.write_text(OTHER_DEVICES + shown)
    rig = rigs.load(file)
    rigs.check(rig, STEP)
    assert tracker_of(rig).rate_hz == 5000
    defaults = dict(re.findall(r"#define (\w+) (\d+)\n", (board.FIRMWARE / "settings.h").read_text()))
    at_gate = tracker_of(rig).counts(np.array([20.0, 10.0])).tolist()
    assert [int(defaults["GATE_TOP_COUNTS"]), int(defaults["GATE_BOTTOM_COUNTS"])] == at_gate
