"""How hard a foot presses on the panel, by a sensor under it whose readings stand in the tracker's frames of a step.

`trials` looks this up for a protocol that records it. What the sensor reads in the last moment before the gate, with
the foot in the air, is the panel's own weight and the sensor's drift, and counts as zero of this step.
"""

from datetime import date

import numpy as np

from palpate.experiment.apparatus.rig import Rig, needed, tracker_of
from palpate.experiment.apparatus.tracker import frames
from palpate.experiment.apparatus.tracker.settings import TrackerRig
from palpate.experiment.errors import RigError
from palpate.experiment.records.tracker import Pressed

AIR_US = 50_000
"""So long before the gate the foot is surely in the air: it comes down from above it."""

RESTS_US, UNTIL_US = 100_000, 200_000
"""After contact the mean is taken between these times: the impact has died down. A step is recorded until then."""

LEAST = 0.5
"""A stretch of which fewer samples came says nothing."""


def refuse(rig: Rig) -> None:
    """Raise `RigError` for a rig that measures the force of the foot, which the protocol does not record."""
    what = "its tracker.force measures the foot's force, but the protocol does not record it"
    remedy = "get approval for footstep.force = true, or remove the table and send frames with one reading"
    raise RigError(f"rig '{rig.rig.name}'", what, remedy)


def check(rig: Rig) -> None:
    """Raise `RigError` for a rig without a sensor of the force."""
    remedy = "connect the sensor to the tracker's board, then add sensor, calibration and calibrated_on to the rig file"
    needed(rig, "tracker.force", tracker_of(rig).force, remedy, "because the protocol records the foot's force")


ANEW = "calibrate the sensor again, with the empty panel and with known weights, and write the date into the rig file"
"""The remedy for a calibration that is too old."""


def check_age(rig: Rig, today: date) -> None:
    """Raise `RigError` for a real rig whose sensor was calibrated too long ago, or in the future.

    That holds for as many days as the calibration of the heights, which `zeroing.check_age` asks for.
    """
    tracker = tracker_of(rig)
    if rig.rig.simulated or tracker.force is None or tracker.calibration_days is None:
        return
    made, days = tracker.force.calibrated_on, tracker.calibration_days
    if not 0 <= (today - made).days <= days:
        where, allowed = f"rig '{rig.rig.name}': tracker.force.calibrated_on", f"0 to {days} days before {today}"
        raise RigError(where, f"got {made}", ANEW, allowed=allowed)


def pressed(raw: bytes, tracker: TrackerRig, gate_top_us: float, contact_us: float) -> Pressed:
    """Return what the frames of a step, from arming to its tail, say of the force of the foot."""
    if tracker.force is None:
        raise RuntimeError("no force is recorded without a sensor")
    decoder = frames.Decoder(near_us=round(contact_us), period_us=1e6 / tracker.rate_hz, readings=tracker.readings)
    _, decoded = decoder.feed(raw)
    us, read_n = decoded.device_us, tracker.force_n(decoded.along)

    def stretch(begin_us: float, end_us: float) -> slice | None:
        """Return the samples between two times; None if too few came."""
        part = slice(*np.searchsorted(us, [begin_us, end_us]).tolist())
        enough = LEAST * (end_us - begin_us) * 1e-6 * tracker.rate_hz
        return part if part.stop - part.start >= enough else None

    air = stretch(gate_top_us - AIR_US, gate_top_us)
    rest, landed = stretch(contact_us + RESTS_US, contact_us + UNTIL_US), stretch(contact_us, contact_us + UNTIL_US)
    if air is None:
        return Pressed(problem="too few samples came before the gate, so the force has no zero")
    if rest is None or landed is None:
        return Pressed(problem="too few samples came after contact")
    zero_n, forces_n = float(read_n[air].mean()), [point.n for point in tracker.force.calibration]
    return Pressed(
        mean_n=round(float(read_n[rest].mean()) - zero_n, 3),
        peak_n=round(float(read_n[landed].max()) - zero_n, 3),
        zero_n=round(zero_n, 3),
        spread_n=round(float(read_n[air].std()), 3),
        held=int(np.isin(np.append(read_n[air], read_n[landed]), (min(forces_n), max(forces_n))).sum()),
    )
