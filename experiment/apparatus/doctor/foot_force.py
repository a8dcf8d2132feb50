"""Checks of the sensor of the foot's force, with nobody on the panel: how old its calibration is, and what it reads.

That is its zero, the panel's own weight and the sensor's drift, which `wires/foot_force.py` takes off each step.
"""

from collections.abc import Iterator
from datetime import date

import numpy as np

from palpate.experiment.apparatus.doctor.checks import judged, passed, refused, unchecked
from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.apparatus.tracker import frames, zeroing
from palpate.experiment.apparatus.tracker.settings import ForceRig, TrackerRig
from palpate.experiment.apparatus.wires import foot_force
from palpate.experiment.errors import Finding, Remedy, RigError

NAME = "foot force"
"""The name of the check of what the sensor reads."""

SEE = "check that the sensor and its amplifier have power and use the second input of the tracker's board"


def missing(rig: Rig) -> Iterator[Finding]:
    """Yield that a rig has no such sensor, though a protocol records the force; nothing of one that has."""
    try:
        foot_force.check(rig)
    except RigError as error:
        yield refused(NAME, error)


def age(rig: Rig, force: ForceRig, today: date) -> Finding:
    """Return how old the calibration is, which holds as many days as that of the heights."""
    name, days = "foot force age", tracker_of(rig).calibration_days
    if rig.rig.simulated:
        return unchecked(name, "calibrations of a simulated rig do not expire")
    if days is None:
        return unchecked(
            name, "the rig file does not state tracker.calibration_days", Remedy("run {}", zeroing.CALIBRATE)
        )
    try:
        foot_force.check_age(rig, today)
    except RigError as error:
        return refused(name, error)
    return passed(name, f"{(today - force.calibrated_on).days} days old", f"0 to {days} days")


def at_rest(raw: bytes, tracker: TrackerRig) -> Finding:
    """Return zero and spread of the frames of a panel that nobody is on; a sensor that is dead, or held, is red."""
    _, decoded = frames.Decoder(readings=tracker.readings).feed(raw)
    read_n, ends_n = tracker.force_n(decoded.along), tracker.force_n(np.array([0, 65535]))
    low_n, high_n = sorted(ends_n.tolist())
    allowed = f"some noise, and within the calibrated range, {low_n:g} to {high_n:g} N"
    if not read_n.size:
        remedy = "make the firmware or driver send the force reading after the height: palpate docs devices"
        return judged(NAME, False, "no frame has a second reading", allowed=allowed, remedy=remedy)
    measured = f"{read_n.mean():.2f} N with nobody on the panel, SD {read_n.std():.3f} N"
    if np.ptp(decoded.along) == 0:
        stuck, gain = f"{measured}: the same in every frame", "raise its gain until readings at rest show noise"
        return judged(NAME, False, stuck, allowed=allowed, remedy=f"{SEE}; if they do, {gain}")
    held = float(np.isin(read_n, ends_n).mean())
    if held > zeroing.HELD_PART:
        at_end = f"{measured}: {held:.0%} of the samples are at or beyond an end of the calibrated range"
        wider = "check that nothing is on the panel, or extend the calibration beyond the reading of the bare panel"
        return judged(NAME, False, at_end, allowed=allowed, remedy=f"{SEE}; {wider}")
    return passed(NAME, measured, allowed)
