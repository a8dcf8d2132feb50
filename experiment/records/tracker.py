"""What is on record of a step by the tracker's frames: how the link did, its clock, and how hard the foot pressed."""

from typing import Annotated

from pydantic import Field

from palpate.experiment.records.entries import Record
from palpate.experiment.records.stimulus import MOST_US

MOST_PPM = 1e6
"""No clock runs twice as fast as another."""

WholeUs = Annotated[int, Field(ge=-MOST_US, le=MOST_US)]


class Link(Record):
    """Frames of the tracker between arming and contact; `received` counts those up to contact."""

    received: int
    lost: int
    damaged: int
    repeated: int


class TrackerClock(Record):
    """A line from device to session time at the end of a step: `anchor_us` was at `anchor_ns`, with a drift in ppm."""

    anchor_us: WholeUs
    anchor_ns: int
    drift_ppm: Annotated[float, Field(ge=-MOST_PPM, le=MOST_PPM)]


class Pressed(Record):
    """How hard the foot pressed, by the sensor under the panel: what it read less what it read before the gate, N.

    `mean_n` is the mean from 0.1 to 0.2 s after contact, `peak_n` the largest from contact on. `zero_n` is what the
    sensor read before the gate, with the standard deviation `spread_n`. `held`: samples before the gate and after
    contact at an end of the sensor's calibration, or beyond. None where `problem` says why.
    """

    mean_n: float | None = None
    peak_n: float | None = None
    zero_n: float | None = None
    spread_n: float | None = None
    held: int = 0
    problem: str = ""
