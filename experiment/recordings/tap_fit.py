"""One decaying sinusoid, fitted to the ring of a recorded tap: f, B and the peak, for `palpate tap fit`.

The model is equation (2) of Wellman and Howe with a phase, and a baseline that may drift, since a recorder's does:

    y(t) = exp(-B t) (s sin(2 pi f t) + c cos(2 pi f t)) + d + e t

Least squares cover the largest sample until the envelope falls to `UNTIL`, without clipped samples, which are reported.
A ring with more than one mode, or none, is a misfit.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import isfinite, log, pi
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import fft, optimize

from palpate.experiment.errors import Finding, PalpateError, RecordingError
from palpate.experiment.recordings.readers import Recording, read
from palpate.experiment.settings.delimited import NOTHING_STATED, Stated, Understood, read_table
from palpate.experiment.settings.units import in_unit
from palpate.experiment.synthesis.tap import Exponential, Scaling, frequency_curve, scaling

UNTIL = 0.25
"""Part of the envelope at which the fit ends, -12 dB: other modes are small by then, and f has not drifted far."""

LEAST_R2 = 0.9
"""Below this share of the variance the recording is a misfit. Ours."""

FEWEST_PERIODS, FEWEST_SAMPLES = 3.0, 24
"""What a window holds at least: fewer do not tell a frequency from a drift."""

CLIPPED_RUN, CLIPPED_EDGE = 3, 2e-3
"""A recorder clips where so many samples in a row are the very largest, and one beside them is off by such a part."""

COLUMNS = ("file", "surface", "stiffness_n_m", "speed_m_s")


@dataclass(frozen=True)
class Ring:
    """The ring of one recording; what was not fitted is None, and `misfit` says why.

    `peak` is the fitted envelope at the largest sample, whose magnitude is `recorded_peak`, in `unit`; `..._se` are
    standard errors. `f_drift_hz` is f of the window's second half less the first's; `baseline_drift` is e, per second.
    """

    file: str
    channel: str
    unit: str
    rate_hz: float
    recorded_peak: float
    clipped_samples: int
    clipped_at: tuple[float, ...]
    window_s: tuple[float, float] | None = None
    f_hz: float | None = None
    f_se_hz: float | None = None
    decay_per_s: float | None = None
    decay_se_per_s: float | None = None
    peak: float | None = None
    peak_se: float | None = None
    baseline: float | None = None
    baseline_drift: float | None = None
    f_drift_hz: float | None = None
    r2: float | None = None
    misfit: str = ""
    read_as: Understood | None = None
    doubts: tuple[Finding, ...] = ()

    def as_dict(self) -> dict[str, object]:
        """Return the fit for JSON."""
        read_as = self.read_as.as_dict() if self.read_as else None
        return {**asdict(self), "read_as": read_as, "doubts": [doubt.sentence() for doubt in self.doubts]}

    def text(self) -> str:
        """Return the fit in a few lines."""
        unit = f" {self.unit}" if self.unit else ""
        lines = [f"{self.file}: {self.channel}, {self.rate_hz:.6g} Hz"]
        lines += [f"  {self.read_as.sentence()}"] if self.read_as else []
        lines += [f"  CAUTION: {doubt.clause()}" for doubt in self.doubts]
        if self.misfit:
            lines.append(f"  MISFIT: {self.misfit}")
        else:
            assert self.window_s is not None  # noqa: S101
            begins, ends = self.window_s
            drift = "not available (too short)" if self.f_drift_hz is None else f"{self.f_drift_hz:+.2f} Hz"
            lines += [
                f"  f {self.f_hz:.2f} Hz (standard error {self.f_se_hz:.2g}), B {self.decay_per_s:.2f} /s "
                f"({self.decay_se_per_s:.2g}), peak of the fitted curve {self.peak:.4g}{unit} ({self.peak_se:.2g}), "
                f"R2 {self.r2:.4f}; Newey-West standard errors, because residuals are correlated",
                f"  from {begins:.5g} to {ends:.5g} s; drift of f from the first half to the second: {drift}; drift of "
                f"the baseline: {self.baseline_drift:+.3g}{unit} per second",
            ]
        if self.clipped_samples:
            levels = " and ".join(f"{level:.4g}" for level in self.clipped_at)
            lines.append(
                f"  The peaks are clipped: {self.clipped_samples} samples at {levels}{unit} were left out, so the true "
                "peak is higher. The fitted peak is based on the other samples."
            )
        return "\n".join(lines)


@dataclass(frozen=True)
class _Fit:
    f_hz: float
    f_se_hz: float
    decay_per_s: float
    decay_se_per_s: float
    peak: float
    peak_se: float
    baseline: float
    baseline_drift: float
    r2: float


def of_file(path: Path, *, channel: str | None = None, stated: Stated = NOTHING_STATED) -> Ring:
    """Return the fit of one channel of a file. Raises `RecordingError` as `readers.read` does."""
    return ring(read(path, channel=channel, stated=stated))


def ring(recording: Recording) -> Ring:
    """Return the fit of the ring of a recording, or why there is none."""
    y, rate = recording.samples, recording.rate_hz
    clipped = clipped_samples(y)
    quiet = float(np.median(y))
    largest = int(np.argmax(np.abs(y - quiet)))
    known = Ring(
        file=recording.file,
        channel=recording.channel,
        unit=recording.unit,
        rate_hz=rate,
        recorded_peak=float(np.abs(y[largest])),
        clipped_samples=int(np.count_nonzero(clipped)),
        clipped_at=tuple(sorted(set(y[clipped].tolist()))),
        read_as=recording.read_as,
        doubts=recording.doubts,
    )

    def misfit(why: str) -> Ring:
        return replace(known, misfit=why)

    tail, kept = y[largest:], ~clipped[largest:]
    if tail.size < FEWEST_SAMPLES:
        return misfit(
            f"{tail.size} samples follow the peak, but {FEWEST_SAMPLES} are needed. Record for longer after the tap."
        )
    if not np.abs(tail - quiet).max() > 1e-12 * max(np.abs(y).max(), 1e-300):
        return misfit("the signal does not change. Check the sensor and the channel.")
    fit = _fitted(tail, kept, rate, *_guess(tail, kept, rate))
    if fit is None:
        return misfit(_NO_MODE)
    size = tail.size
    for _ in range(3):
        wanted = round(rate * max(log(1 / UNTIL) / fit.decay_per_s, FEWEST_PERIODS / fit.f_hz))
        size = min(max(wanted, FEWEST_SAMPLES), tail.size)
        again = _fitted(tail[:size], kept[:size], rate, fit.f_hz, fit.decay_per_s)
        if again is None:
            return misfit(_NO_MODE)
        fit = again
    if fit.r2 < LEAST_R2:
        return misfit(
            f"the best decaying sinusoid, at {fit.f_hz:.4g} Hz, explains {max(fit.r2, 0):.0%} of the variance, but "
            f"{LEAST_R2:.0%} is needed. {_NO_MODE}"
        )
    if size * fit.f_hz / rate < FEWEST_PERIODS - 0.5:
        return misfit(f"the ringing has only {size * fit.f_hz / rate:.1f} periods, but {FEWEST_PERIODS:g} are needed.")
    half = size // 2
    halves = [
        _fitted(tail[part], kept[part], rate, fit.f_hz, fit.decay_per_s) for part in (slice(half), slice(half, size))
    ]
    early, late = (one.f_hz if one else float("nan") for one in halves)
    window, drift = (largest / rate, (largest + size) / rate), late - early
    return replace(known, window_s=window, f_drift_hz=drift if isfinite(drift) else None, **asdict(fit))


_NO_MODE = "The recording does not show a single ringing, decaying mode; inspect it with `palpate spectrum`."


def clipped_samples(samples: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which samples a recorder has clipped, in the shape of the samples, (n,).

    They are all at a largest or smallest value that has a run of `CLIPPED_RUN` or more beside a step; the flat top of a
    slow wave has only the converter's steps.
    """
    found = np.zeros(samples.size, dtype=np.bool_)
    spread = float(np.ptp(samples))
    for level in (samples.max(), samples.min()):
        at = samples == level
        edges = np.flatnonzero(np.diff(np.concatenate([[False], at, [False]]).astype(np.int8)))
        for begins, ends in edges.reshape(-1, 2).tolist():
            beside = [samples[i] for i in (begins - 1, ends) if 0 <= i < samples.size]
            steps = [abs(value - level) for value in beside]
            if ends - begins >= CLIPPED_RUN and steps and max(steps) > CLIPPED_EDGE * spread:
                found |= at
                break
    return found


def _guess(tail: NDArray[np.float64], kept: NDArray[np.bool_], rate: float) -> tuple[float, float]:
    """Return a frequency from the spectrum, Hz, and a decay from the energy of the first and the second half, 1/s."""
    swing = np.where(kept, tail - tail[kept].mean(), 0.0)
    amplitudes = np.abs(fft.rfft(swing, 4 * swing.size))
    f = max(int(np.argmax(amplitudes)), 1) * rate / (4 * swing.size)
    half = swing.size // 2
    early, late = float(np.sum(swing[:half] ** 2)), float(np.sum(swing[half : 2 * half] ** 2))
    decay = log(early / late) * rate / (2 * half) if 0 < late < early else rate / swing.size
    return f, max(decay, rate / (10 * swing.size))


def _fitted(
    samples: NDArray[np.float64], kept: NDArray[np.bool_], rate: float, f_hz: float, decay_per_s: float
) -> _Fit | None:
    """Return the best fit near a frequency and a decay; None where it does not ring, or does not die away."""
    t = np.arange(samples.size) / rate
    wanted, times = samples[kept], t[kept]
    if wanted.size < FEWEST_SAMPLES // 2:
        return None

    def solved(shape: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        f, decay = shape
        envelope = np.exp(np.clip(-decay * times, -700.0, 50.0))
        terms = np.stack(
            [
                envelope * np.sin(2 * pi * f * times),
                envelope * np.cos(2 * pi * f * times),
                np.ones_like(times),
                times * rate / samples.size,
            ],
            axis=1,
        )
        weights = np.linalg.lstsq(terms, wanted, rcond=None)[0]
        return terms, weights, terms @ weights - wanted

    found = optimize.least_squares(
        lambda shape: solved(shape)[2], (f_hz, decay_per_s), x_scale=(max(f_hz, 1e-9), max(decay_per_s, 1e-9))
    )
    f, decay = found.x.tolist()
    terms, weights, residual = solved(found.x)
    variance = float(np.sum((wanted - wanted.mean()) ** 2))
    if not (0 < f < rate / 2 and decay > 0 and variance > 0):
        return None
    envelope = float(np.hypot(weights[0], weights[1]))
    swing = terms[:, :2] @ weights[:2]
    turned = terms[:, 1] * weights[0] - terms[:, 0] * weights[1]
    sensitivity = np.column_stack([2 * pi * times * turned, -times * swing, terms])
    covariance = _covariance(sensitivity, residual, kept)
    of_peak = np.array([0.0, 0.0, *(weights[:2] / max(envelope, 1e-300)), 0.0, 0.0])
    variances = covariance[0, 0], covariance[1, 1], of_peak @ covariance @ of_peak
    f_se, decay_se, peak_se = np.sqrt(np.maximum(variances, 0.0)).tolist()
    return _Fit(
        f_hz=f,
        f_se_hz=f_se,
        decay_per_s=decay,
        decay_se_per_s=decay_se,
        peak=envelope,
        peak_se=peak_se,
        baseline=float(weights[2]),
        baseline_drift=float(weights[3]) * rate / samples.size,
        r2=1 - float(np.sum(residual**2)) / variance,
    )


def _covariance(
    sensitivity: NDArray[np.float64], residual: NDArray[np.float64], kept: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the covariance of the fit, shape (k, k), from sensitivities, (n, k), and residuals, (n,), in time."""
    sizes = np.maximum(np.linalg.norm(sensitivity, axis=0), 1e-300)
    scaled = sensitivity / sizes
    scores = np.zeros((kept.size, sizes.size))
    scores[kept] = scaled * residual[:, None]
    power = np.sum(scores[:-1] ** 2, axis=0)
    alike = np.clip(np.sum(scores[1:] * scores[:-1], axis=0) / np.maximum(power, 1e-300), -0.97, 0.97)
    weight = power**2 * (1 + alike) ** 2 / (1 - alike) ** 2
    slow = float(np.sum(weight * 4 * alike**2 / (1 - alike**2) ** 2) / max(np.sum(weight), 1e-300))
    lags = min(int(1.1447 * (slow * residual.size) ** (1 / 3)), kept.size - 1)
    meat = scores.T @ scores
    for lag in range(1, lags + 1):
        both = scores[lag:].T @ scores[:-lag]
        meat += (1 - lag / (lags + 1)) * (both + both.T)
    inverse = np.linalg.pinv(scaled.T @ scaled)
    return np.asarray(inverse @ meat @ inverse / np.outer(sizes, sizes))


@dataclass(frozen=True)
class TapSet:
    """Taps at several speeds: L, in `unit`, and D of each surface, in order, and f over stiffness (`curve`).

    `unscaled` has a sentence for each surface without L and D, `no_curve` says why there is no `curve`.
    """

    surfaces: tuple[str, ...]
    stiffness_n_m: tuple[float, ...]
    f_hz: tuple[float, ...]
    scalings: tuple[Scaling | None, ...]
    unscaled: tuple[str, ...]
    curve: Exponential | None
    no_curve: str
    unit: str

    def text(self) -> str:
        """Return the same for a reader."""
        unit = f" {self.unit}" if self.unit else ""
        lines = ["Amplitude A = L D V, where L is the amplitude at 0.2 m/s:"]
        for name, made in zip(self.surfaces, self.scalings, strict=True):
            if made:
                worst = max(map(abs, made.misfits))
                found = f"L {made.amplitude:.4g}{unit}, D {made.per_speed_s_m:.4g} s/m"
                lines.append(f"  {name}: {found}, off by up to {worst:.1%} of L")
        lines += [f"  {sentence}" for sentence in self.unscaled]
        if self.curve is None:
            return "\n".join([*lines, self.no_curve])
        lines.append(
            f"Frequency against stiffness: f = {self.curve.at_zero_hz:.4g} Hz exp(K / {self.curve.per_n_m:.4g} N/m), "
            f"R2 of ln f {self.curve.r2:.3f}"
        )
        for name, k, f in zip(self.surfaces, self.stiffness_n_m, self.f_hz, strict=True):
            fitted = self.curve.at(k)
            lines.append(f"  {name}: {k:g} N/m, {f:.4g} Hz, fitted {fitted:.4g} Hz ({fitted / f - 1:+z.0%})")
        return "\n".join(lines)


@dataclass(frozen=True)
class Tapped:
    """A row of the table of taps: which surface, N/m, was tapped how fast, m/s, in which file."""

    file: str
    surface: str
    stiffness_n_m: float
    speed_m_s: float


def read_taps(path: Path, stated: Stated = NOTHING_STATED) -> tuple[Tapped, ...]:
    """Return a table of taps with `COLUMNS`, its files relative to it. Raises `RecordingError` for bad cells."""
    try:
        table = read_table(path, COLUMNS, COLUMNS[2:], stated)
    except PalpateError as error:
        raise RecordingError.saying(error) from None
    if sorted(table.header) != sorted(COLUMNS):
        raise RecordingError(
            path,
            f"got the columns {', '.join(table.header) or '(none)'}",
            "correct the heading",
            allowed=f"{', '.join(COLUMNS)}, with a row for each recording",
        )
    if not table.rows or any(len(row.cells) > len(COLUMNS) for row in table.rows):
        got = "a row with more cells than the heading" if table.rows else "no row below the heading"
        raise RecordingError(path, f"got {got}", "correct the table", allowed="a row for each recording")
    taps = []
    for row in table.rows:
        cells = dict.fromkeys(COLUMNS, "") | dict(zip(table.header, map(str.strip, row.cells), strict=False))
        stiffness, speed = (table.number(cells[name]) for name in COLUMNS[2:])
        if not (0 < stiffness < float("inf") and 0 < speed < float("inf")):
            raise RecordingError(
                path,
                f"got {cells['stiffness_n_m']!r} N/m and {cells['speed_m_s']!r} m/s",
                "correct the line",
                allowed="finite numbers above zero",
                line=row.line,
            )
        taps.append(Tapped(cells["file"], cells["surface"], stiffness, speed))
    return tuple(taps)


def of_taps(rings: Sequence[Ring], taps: Sequence[Tapped]) -> TapSet:
    """Return L, D and f over stiffness as the paper derives them. Raises `RecordingError` if files and table differ."""
    found = _by_surface(rings, taps)
    unit = rings[0].unit if rings else ""
    whole = {name: group for name, group in found.items() if group}
    scalings: list[Scaling | None] = []
    unscaled = [f"{name}: no recording was fitted." for name in found if name not in whole]
    for name, group in whole.items():
        speeds, peaks = [tap.speed_m_s for tap, _ in group], [_peak(one, unit) for _, one in group]
        if len(set(speeds)) < 2:
            unscaled.append(f"{name}: L and D require two or more speeds; tap it at another speed.")
            scalings.append(None)
        else:
            scalings.append(scaling(speeds, peaks))
    stiffness = tuple(group[0][0].stiffness_n_m for group in whole.values())
    f_hz = tuple(float(np.median([one.f_hz or 0.0 for _, one in group])) for group in whole.values())
    enough = len(set(stiffness)) >= 2
    return TapSet(
        surfaces=tuple(whole),
        stiffness_n_m=stiffness,
        f_hz=f_hz,
        scalings=tuple(scalings),
        unscaled=tuple(unscaled),
        curve=frequency_curve(stiffness, f_hz) if enough else None,
        unit=unit,
        no_curve=""
        if enough
        else "A curve of frequency against stiffness requires surfaces with at least two different stiffnesses.",
    )


def _peak(one: Ring, unit: str) -> float:
    """Return the peak of a ring in the unit of the first recording. Raises `RecordingError` where none is known."""
    peak = in_unit(one.peak or 0.0, one.unit, unit)
    if peak is None:
        raise RecordingError(
            one.file,
            f"got a peak in {one.unit or 'no unit'}, but others in {unit or 'no unit'}",
            "add the unit to the heading, or fit these recordings separately",
            allowed="recordings in one unit, or in units of acceleration",
        )
    return peak


def _by_surface(rings: Sequence[Ring], taps: Sequence[Tapped]) -> dict[str, list[tuple[Tapped, Ring]]]:
    """Return the taps of each surface that were fitted, none perhaps, with their fits."""
    by_name = {Path(one.file).name: one for one in taps}
    found: dict[str, list[tuple[Tapped, Ring]]] = {}
    for one in rings:
        tap = by_name.get(Path(one.file).name)
        if tap is None:
            raise RecordingError(one.file, "is not in the table of taps", "add a row for it")
        group = found.setdefault(tap.surface, [])
        if group and group[0][0].stiffness_n_m != tap.stiffness_n_m:
            raise RecordingError(
                one.file,
                f"got {tap.stiffness_n_m:g} N/m for {tap.surface}, but {group[0][0].stiffness_n_m:g} N/m above",
                "correct the table",
                allowed="one stiffness per surface",
            )
        if not one.misfit:
            group.append((tap, one))
    return found
