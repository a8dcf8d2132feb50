"""Uneven times, gaps and clipping, of signals with a closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment.errors import RecordingError, Remedy
from palpate.experiment.recordings.grid import LONGEST_GAP, clipping, even, mark, resampled
from palpate.experiment.recordings.readers import Axes, read
from palpate.experiment.settings.delimited import Stated
from tests.approved import Refuses

RESAMPLE = Stated(resample=True, command=("palpate", "spectrum", "a.csv"))


def _wave(times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 20 Hz and 30 Hz, which a tenth of 1 kHz and half of that both show."""
    return np.asarray(np.sin(2 * np.pi * 20 * times) + 0.5 * np.cos(2 * np.pi * 30 * times))


def _uneven(seed: int, count: int = 1000) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    times = np.arange(count) / 1000 + rng.uniform(-0.0004, 0.0004, count)
    return np.asarray(times - times[0])


@pytest.mark.parametrize("seed", range(5))
def test_what_is_resampled_is_the_signal_within_the_error_that_is_stated(seed: int) -> None:
    times = _uneven(seed)
    made = resampled(times, _wave(times), range(1, 1001))
    assert made is not None
    assert made.grid.rate_hz == pytest.approx(1000, rel=0.02)
    truth = _wave(np.arange(made.samples.size) / made.grid.rate_hz)
    assert float(np.sqrt(np.mean((made.samples - truth) ** 2)) / truth.std()) <= made.error < 0.01
    assert (made.bridged, made.longest) == (0, 0)


def test_missing_samples_are_bridged_and_counted_and_a_longer_gap_is_refused(refuses: Refuses) -> None:
    times = np.delete(np.arange(1000) / 1000, range(300, 300 + LONGEST_GAP))
    made = resampled(times, _wave(times), range(1, times.size + 1))
    assert made is not None
    assert (made.samples.size, made.bridged, made.longest) == (1000, LONGEST_GAP, LONGEST_GAP)
    assert float(np.abs(made.samples - _wave(np.arange(1000) / 1000)).max()) < 0.02
    times = np.delete(np.arange(1000) / 1000, range(300, 301 + LONGEST_GAP))
    with refuses(RecordingError):
        resampled(times, _wave(times), range(1, times.size + 1))
    with pytest.raises(RecordingError) as refused:
        resampled(np.array([0, 1e-3, 1e-3, 2e-3]), np.zeros(4), range(1, 5))
    finding = refused.value.finding
    assert (finding.line, finding.allowed) == (3, "increasing times")


def test_a_file_with_uneven_times_names_the_option_that_reads_it(tmp_path: Path) -> None:
    file, times = tmp_path / "a.csv", _uneven(1)
    rows = zip(times.tolist(), _wave(times).tolist(), strict=True)
    file.write_text("time (s),a (g)\n" + "".join(f"{t},{a}\n" for t, a in rows))
    with pytest.raises(RecordingError) as refused:
        read(file, stated=Stated(command=("palpate", "spectrum", "a.csv")))
    remedy = refused.value.finding.remedy
    assert isinstance(remedy, Remedy)
    assert remedy.command == ("palpate", "spectrum", "a.csv", "--resample")
    found = read(file, stated=RESAMPLE)
    assert [doubt.check for doubt in found.doubts] == ["resampled"]
    assert abs(found.samples.size - 1000) < 20


def test_even_times_stay_as_they_are_whatever_is_stated(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text("time (s),a (g)\n" + "".join(f"{i / 1000:.3f},{i % 7}\n" for i in range(50)))
    assert read(file, stated=RESAMPLE).samples.tolist() == [i % 7 for i in range(50)]
    assert read(file, stated=RESAMPLE).doubts == ()


def test_three_axes_of_a_file_are_one_channel(tmp_path: Path, refuses: Refuses) -> None:
    file = tmp_path / "a.csv"
    rows = "".join(f"{i / 1000:.3f},{i % 3},{i % 5},{9.81 + i % 2}\n" for i in range(60))
    file.write_text(f"time (s),x (g),y (g),z (g)\n{rows}")
    one = read(file, axes=Axes(("x", "y", "z")))
    parts = [read(file, channel=name).samples for name in "xyz"]
    power = sum(float(part.var()) for part in parts)
    assert (one.channel, one.unit) == ("dft321 of x, y, z", "g")
    assert float(one.samples.var()) == pytest.approx(power)
    assert float(read(file, axes=Axes(("1", "2", "3"), "norm")).samples.min()) >= 0
    file.write_text(f"time (s),x (g),y (m/s^2),z (g)\n{rows}")
    with refuses(RecordingError):
        read(file, axes=Axes(("x", "y", "z")))
    with pytest.raises(RecordingError) as refused:
        read(file, axes=Axes(("x", "1", "z")))
    assert refused.value.finding.allowed == "different channels"


@pytest.mark.parametrize("dtype", [np.float64, np.int16])
def test_a_signal_that_was_cut_looks_clipped_and_whole_ones_do_not(dtype: type[np.generic]) -> None:
    turns = np.arange(2000) / 2000
    waves = [np.sin(2 * np.pi * cycles * turns) * 1000 for cycles in (1, 7, 50, 333)]
    rng = np.random.default_rng(1)
    for wave in (*waves, rng.normal(size=2000) * 300, np.zeros(2000), np.repeat([0.0, 800.0, 0.0], 700)):
        assert clipping(wave.astype(dtype)) is None
    noisy = np.sin(2 * np.pi * 47.3 * turns) * 1000 + rng.uniform(-1, 1, 2000)
    assert clipping(noisy.astype(dtype)) is None
    found = clipping(np.clip(noisy, -700, 700).astype(dtype))
    assert found is not None
    assert found.ends == (700.0, -700.0)
    assert 90 <= found.runs <= 95
    assert 900 < found.samples < 1100


@pytest.mark.parametrize(
    ("rate_hz", "digits"), [(800, 3), (400, 3), (3200, 4), (800, 2), (1023.7, 4)], ids=lambda value: f"{value:g}"
)
def test_times_in_too_few_digits_give_the_rate_of_all_of_them(tmp_path: Path, rate_hz: float, digits: int) -> None:
    file = tmp_path / "a.csv"
    times = np.floor(np.arange(1000) / rate_hz * 10**digits + 1e-9) / 10**digits
    file.write_text("time (s),a (g)\n" + "".join(f"{t:.{digits}f},{i % 7}\n" for i, t in enumerate(times)))
    for stated in (Stated(), RESAMPLE):
        made = read(file, stated=stated)
        assert made.rate_hz == pytest.approx(rate_hz, rel=10**-digits * rate_hz / 999)
        assert made.samples.tolist() == [i % 7 for i in range(1000)]
    assert {doubt.check for doubt in made.doubts} <= {"rounded"}


@pytest.mark.parametrize("missing", [1, 5, 30])
def test_samples_that_are_missing_are_not_taken_for_rounded_times(missing: int) -> None:
    gone = np.random.default_rng(missing).choice(np.arange(1, 999), missing, replace=False)
    times = np.delete(np.arange(1000) / 1000, gone)
    with pytest.raises(RecordingError):
        even(times, range(1, times.size + 1), Stated())
    made = resampled(times, _wave(times), range(1, times.size + 1))
    assert made is not None
    assert made.bridged == missing
    assert made.grid.rate_hz == pytest.approx(1000)


def test_a_steady_tone_that_was_cut_looks_clipped() -> None:
    for cycles, count, whole in ((25, 4800, 2**15 - 1), (25, 4800, 2**23 - 1)):
        tone = 1.4 * np.sin(2 * np.pi * cycles * np.arange(count) / count)
        found = clipping(np.round(np.clip(tone, -1, 1) * whole).astype(np.int32))
        assert found is not None
        assert (found.runs, found.ends) == (2 * cycles, (whole, -whole))
        assert clipping(np.round(tone / 1.4 * whole).astype(np.int32)) is None


def test_a_signal_that_rests_at_zero_is_not_clipped_there() -> None:
    gated = np.tile([0.0, 0, 0, 0, 0.3, 0.5, 0.9, 0.7, 0.4, 0.2, 0.6, 0.8], 50)
    gated[gated > 0] += np.random.default_rng(1).uniform(0, 0.1, np.count_nonzero(gated))
    assert clipping(gated) is None


@pytest.mark.parametrize(("value", "often"), [(-999.0, 2), (9.9e37, 1), (-32768.0, 5)])
def test_a_value_far_from_all_others_is_a_mark_of_missing_samples(value: float, often: int, tmp_path: Path) -> None:
    times = np.arange(400) / 1000
    samples = _wave(times)
    samples[50 : 50 + often] = value
    found = mark(samples)
    assert found is not None
    assert (found.value, found.samples) == (value, often)
    path = tmp_path / "marked.csv"
    rows = "".join(f"{at:.3f},{one!r}\n" for at, one in zip(times, samples.tolist(), strict=True))
    path.write_text(f"time (s),x (g)\n{rows}", "utf-8")
    assert [doubt.check for doubt in read(path).doubts] == ["marks"]


def test_taps_pulses_and_steps_hold_no_marks() -> None:
    times = np.arange(2000) / 1000
    tap = 500 * np.exp(-60 * times) * np.sin(2 * np.pi * 120 * times)
    pulses = np.where(np.arange(2000) % 100 == 0, 200.0, 0.0)
    steps = np.where(times < 1, 100.0, 900.0)
    assert [mark(one) for one in (_wave(times), tap, np.round(tap), pulses, steps)] == [None] * 5


@pytest.mark.parametrize(("rate_hz", "samples"), [(2000, 400), (5000, 900), (4000, 700)], ids=str)
def test_the_rate_that_is_proposed_is_that_of_the_fewest_digits_that_fits(
    tmp_path: Path, rate_hz: int, samples: int
) -> None:
    """Times are in hundredths of a second."""
    file = tmp_path / "few.csv"
    file.write_text("time (s),a (g)\n" + "".join(f"{i / rate_hz:.2f},{i % 7}\n" for i in range(samples)))
    with pytest.raises(RecordingError) as refused:
        read(file)
    assert f"--rate {rate_hz} " in f"{refused.value} "
