"""A tracker's driver that a rig file names, guarded, so that its faults are its own.

A file beside the rig file comes first, under a name of its own that hides no other module; else an installed module.
"""

import importlib
import inspect
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import numpy as np

from palpate.experiment.apparatus.ports import Tracker
from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.tracker.frames import Decoder, LinkCounts, Samples
from palpate.experiment.apparatus.tracker.settings import FRAMES
from palpate.experiment.apparatus.wires.own.loading import driver_module, error_words
from palpate.experiment.clock import Clock
from palpate.experiment.errors import PalpateError, RigError, TrackerError


def open_guarded(rig: Rig, where: str, *, clock: Clock, clock_map: ClockMap | None) -> Tracker:
    """Return the tracker at a port through the rig's driver `module:Class`. Raises `RigError` or `TrackerError`."""
    named = tracker_of(rig).driver
    driver = _driver(rig)
    with _blamed(named, "open"):
        tracker = driver(where, rig.tracker, clock=clock, clock_map=clock_map)
    return GuardedTracker(tracker, named, planar=tracker_of(rig).along_calibration is not None)


class GuardedTracker:
    """Implements `Tracker` on top of a driver that may raise anything; `named` is its name in the rig file."""

    def __init__(self, tracker: Tracker, named: str, *, planar: bool = False) -> None:
        self._tracker = tracker
        self._named = named
        self._planar = planar
        self._counts = LinkCounts()
        self._newest: Samples | None = None

    @property
    def counts(self) -> LinkCounts:
        with _blamed(self._named, "counts"):
            counts = self._tracker.counts
            if not isinstance(counts, LinkCounts):
                raise TypeError(f"got {counts!r:.60}, not LinkCounts")
            if not all(isinstance(count, int | np.integer) for count in counts) or min(counts.since(self._counts)) < 0:
                raise ValueError(f"got {counts!r:.90}, not whole numbers that never decrease")
            self._counts = counts
            return counts

    @property
    def clock_map(self) -> ClockMap | None:
        with _blamed(self._named, "clock_map"):
            clock_map = self._tracker.clock_map
            if not (clock_map is None or isinstance(clock_map, ClockMap)):
                raise TypeError(f"got {clock_map!r:.60}, neither a ClockMap nor None")
            return clock_map

    def drain(self) -> None:
        with _blamed(self._named, "drain"):
            self._tracker.drain()

    def read(self) -> Samples:
        with _blamed(self._named, "read"):
            samples = self._tracker.read()
            if not isinstance(samples, Samples):
                raise TypeError(f"got {samples!r:.60}, not Samples")
            if not samples.device_us.shape == samples.height_mm.shape == samples.ends.shape != (0,):
                raise ValueError("device_us, height_mm and ends do not have the same length, at least 1")
            if self._planar and (samples.along_mm is None or samples.along_mm.shape != samples.ends.shape):
                raise ValueError("along_mm, which a planar tracker needs, does not have the same length")
            _check(samples, self._newest)
            # Of several frames the first alone may have been torn.
            first = self._planar and self._newest is None and samples.ends.size > 1
            if first and not Decoder(readings=2).feed(samples.raw)[1].link.received:
                raise ValueError("raw contains no two-reading frame of the kind that encode produces")
            self._newest = samples
            return samples

    def reconnect(self, timeout_s: float) -> None:
        with _blamed(self._named, "reconnect"):
            self._tracker.reconnect(timeout_s)
        self._newest = None

    def close(self) -> None:
        ending = sys.exception()
        try:
            with _blamed(self._named, "close"):
                self._tracker.close()
        except TrackerError as error:
            if isinstance(ending, PalpateError):
                raise ending.followed_by(error) from error
            raise


def _check(samples: Samples, before: Samples | None) -> None:
    """Refuse what no device can have sent after the read `before` it, with a `ValueError`."""
    us, mm, ends = samples.device_us, samples.height_mm, samples.ends
    if us.ndim != 1 or us.dtype.kind != "i" or ends.dtype.kind != "i" or mm.dtype.kind != "f":
        raise ValueError(f"got arrays of {us.dtype}, {mm.dtype} and {ends.dtype}, not rows of int, float and int")
    for name, read in (("height", mm), ("position along the face", samples.along_mm)):
        if read is not None and not np.isfinite(read).all():
            raise ValueError(f"got a {name} of {read[~np.isfinite(read)][0]} mm")
    times = us if before is None else np.concatenate([before.device_us[-1:], us])
    later = times[1:] > times[:-1]
    if not later.all():
        at = int(np.argmin(later))
        raise ValueError(f"got a device time of {times[at + 1]} us after one of {times[at]} us; times must increase")
    if ends[0] < 0 or ends[-1] > len(samples.raw) or (ends[1:] < ends[:-1]).any():
        raise ValueError(f"got ends that are not places in {len(samples.raw)} raw bytes, in order")
    if not isinstance(samples.arrived_ns, int | np.integer) or (before and samples.arrived_ns < before.arrived_ns):
        raise ValueError(f"got an arrival at {samples.arrived_ns!r:.60} ns; arrivals must be whole and never decrease")


@contextmanager
def _blamed(named: str, part: str) -> Iterator[None]:
    try:
        yield
    except (TrackerError, RigError):
        raise
    except (Exception, SystemExit) as error:  # SystemExit would end the session without a word
        raise TrackerError(
            "tracker",
            f"its driver '{named}' failed at `{part}` ({error_words(error)})",
            "restart the device, or have the driver corrected",
        ) from error


def _driver(rig: Rig) -> Callable[..., Tracker]:
    module, _, name = tracker_of(rig).driver.partition(":")
    file = rig.driver_file(tracker_of(rig).driver)
    try:
        found = importlib.import_module(module) if file is None else driver_module(file)
        driver: Callable[..., Tracker] = getattr(found, name)
    except (Exception, SystemExit) as error:  # a module may raise anything while it is imported, and end nothing
        raise _not_a_driver(rig, error) from error
    missing = [name for name in ("read", "drain", "reconnect", "close") if not hasattr(driver, name)]
    if missing:
        raise _not_a_driver(rig, AttributeError(f"it has no {', '.join(missing)}"))
    with suppress(ValueError):  # compiled classes may not say what they are called with
        try:
            inspect.signature(driver).bind("", rig.tracker, clock=None, clock_map=None)
        except TypeError as error:
            raise _not_a_driver(rig, error) from error
    return driver


def _not_a_driver(rig: Rig, error: BaseException) -> RigError:
    remedy = "put its file in the folder of the rig file, install its package, or correct the rig file"
    if isinstance(error, ImportError) and error.name is not None and error.name.partition(".")[0] == "experiment":
        remedy = "make it import from palpate.experiment.apparatus"
    return RigError(
        f"rig '{rig.rig.name}'",
        f"got '{tracker_of(rig).driver}' ({error_words(error)})",
        remedy,
        allowed=f"{FRAMES}, or a class that implements Tracker",
        field="tracker.driver",
    )
