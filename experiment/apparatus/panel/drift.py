"""A panel compared with its measurement before a session: a short multisine with nobody on it, in third octaves.

A third octave's level is that of what repeats each second, without the noise in it. It is compared with what the
measured response makes of what was played, less what a soft spring or coil took from it when the panel was measured.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.apparatus.panel import calibration, multisine
from palpate.experiment.apparatus.panel.calibration import HIGH_HZ, LOW_HZ, UNCERTAIN_DB, Devices
from palpate.experiment.apparatus.panel.conditioning import Drifted
from palpate.experiment.apparatus.panel.movement import DRIFT_DB, ERRORS, Reference, expected_gain, open_movement
from palpate.experiment.apparatus.panel.validity import CALIBRATE
from palpate.experiment.apparatus.rig import MeasuredRig, Rig
from palpate.experiment.errors import Finding, Remedy, RigError

SECONDS, LONGER = 2, 8
"""Seconds of the multisine that count, at first and the second time."""

WARNED_DB, REFUSED_DB = DRIFT_DB, 3.0
"""From so much more or less in any third octave the experimenter is warned, and nobody is run."""

WITHIN = 1.25
"""A stimulus may put its energy elsewhere in a third octave, where drift is up to this many times as large. Ours."""

RESPONSE_DB = 0.15
"""Errors of the measured response alone put a level off by up to this much (SIMULATED, `felt.csv`)."""

THIRD = 10**0.1
"""From one third octave to the next (IEC 61260-1)."""


@dataclass(frozen=True)
class Drift:
    """By how much more a panel moves in a third octave than it was measured to, and the standard error, dB."""

    hz: float
    db: float
    standard_error_db: float


def drifts(
    played: NDArray[np.complex128], heard: NDArray[np.complex128], reference: Reference, *, gain: float
) -> Iterator[Drift]:
    """Yield the drift of each third octave from 10 to 500 Hz in which the reference has a line.

    `played` has the complex amplitude of each line of the reference, shape (K,), and `heard` that of each in each
    period, m/s^2, shape (P, K); a panel that did not drift moves by `gain` times the reference.
    """
    lines_hz = reference.lines_hz
    steady = multisine.without_drift(heard, lines_hz)
    mean = steady.mean(axis=0)
    noise = np.square(np.abs(steady - mean)).sum(axis=0) / (len(steady) - 1) / len(steady)
    power = np.square(np.abs(mean)) - noise
    power_variance = 2 * np.square(np.abs(mean)) * noise + np.square(noise)
    drive = gain**2 * np.square(np.abs(played))
    expected = drive * np.square(np.abs(reference.response_m_s2))
    expected_variance = 4 * drive * expected * np.square(reference.standard_error_m_s2)
    for n in range(round(10 * np.log10(LOW_HZ)), int(10 * np.log10(HIGH_HZ)) + 1):
        hz = 10 ** (n / 10)
        band = (lines_hz >= hz / np.sqrt(THIRD)) & (lines_hz < hz * np.sqrt(THIRD))
        if not band.any():
            continue
        now, then = max(float(power[band].sum()), 1e-12 * float(expected[band].sum())), float(expected[band].sum())
        relative = power_variance[band].sum() / now**2 + expected_variance[band].sum() / then**2
        yield Drift(hz, 10 * float(np.log10(now / then)), 10 / float(np.log(10)) * float(np.sqrt(relative)))


def compare(
    on: Devices, measured: MeasuredRig, reference: Reference, *, peak: float, rng: np.random.Generator
) -> tuple[Drift, ...]:
    """Return the drift of each third octave, measured a second time for longer if any is too uncertain.

    Raises `RecordingError` if it is uncertain then too, and for a sensor that is dead, clips, hears something else or
    lies upside down.
    """
    lines_hz = reference.lines_hz
    amplitudes = peak * multisine.drawn(lines_hz, rate_hz=on.played_hz, rng=rng)
    felt = (lines_hz >= LOW_HZ) & (lines_hz <= HIGH_HZ)
    for seconds in (SECONDS, LONGER):
        heard = calibration.heard(on, amplitudes, lines_hz, seconds)
        mean = multisine.without_drift(heard, lines_hz).mean(axis=0)
        alike = multisine.agreement(mean[felt], (amplitudes * reference.response_m_s2)[felt], lines_hz[felt])
        if abs(alike) < calibration.UNHEARD:
            raise calibration.unheard(abs(alike))
        if alike < 0:
            what = "the sensor is upside down compared with the panel's measurement"
            remedy = "mount the sensor as before, and check that the actuator's two wires are not swapped"
            raise calibration.refusal(what, remedy)
        found = tuple(drifts(amplitudes, heard, reference, gain=expected_gain(measured, peak)))
        worst = max(found, key=lambda one: one.standard_error_db)
        if worst.standard_error_db <= UNCERTAIN_DB:
            return found
    raise calibration.refusal(
        f"the level at {worst.hz:.0f} Hz has a standard error of {worst.standard_error_db:.2f} dB",
        "find out what else shakes the panel",
        allowed=f"{UNCERTAIN_DB:g} dB, after {LONGER} s",
    )


def at_most(found: Sequence[Drift]) -> Drifted:
    """Return the most that a panel can have drifted, with `ERRORS` standard errors; upward, it is not below 0."""
    return Drifted(
        louder_db=max(0.0, *(one.db + ERRORS * one.standard_error_db for one in found)),
        off_db=max(RESPONSE_DB, WITHIN * max(abs(one.db) + ERRORS * one.standard_error_db for one in found)),
    )


def judged(found: Sequence[Drift], rig_file: Path) -> Finding:
    """Return what a comparison shows: it passes, warns, or refuses the rig."""
    most = max(found, key=lambda one: abs(one.db))
    what, allowed = f"at {most.hz:.0f} Hz, its panel differs by {most.db:+.2f} dB from its measurement", ""
    if abs(most.db) < WARNED_DB:
        return Finding(what, rig_file, allowed=f"less than {WARNED_DB:g} dB", verdict="passes")
    remedy = Remedy("check that nothing is on the panel, or run {}", CALIBRATE, suffices=False)
    allowed = f"less than {WARNED_DB:g} dB; sessions are refused from {REFUSED_DB:g} dB"
    return Finding(
        what, rig_file, allowed=allowed, remedy=remedy, verdict="refuses" if abs(most.db) >= REFUSED_DB else "warns"
    )


def is_heard(rig: Rig) -> bool:
    """Return whether the panel of a rig was measured, and an accelerometer stays on it."""
    sensor = rig.accelerometer
    return rig.actuator.measured is not None and sensor is not None and sensor.stays is not False


def compare_panel(rig_file: Path, rig: Rig) -> tuple[Finding, Drifted]:
    """Compare the panel of a rig that `is_heard` with its measurement; return a finding that passes or warns, and
    the drift.

    Raises `RigError` from `REFUSED_DB` on, and `PalpateError` for the devices.
    """
    if (measured := rig.actuator.measured) is None:
        raise RigError.at(Finding("its panel was never measured", rig_file, remedy=Remedy("run {}", CALIBRATE)))
    reference, peak = (
        open_movement(rig_file.parent, measured, rate_hz=rig.actuator.rate_hz).reference,
        measured.check_peak,
    )
    with calibration.devices(rig, loudest=peak) as devices:
        drifted = compare(devices, measured, reference, peak=peak, rng=np.random.default_rng())
    found = judged(drifted, rig_file)
    if found.verdict == "refuses":
        raise RigError.at(found)
    return found, at_most(drifted)
