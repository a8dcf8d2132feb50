"""Devices: what a laboratory's rig file names, opened behind small ports (`ports.py`), and their drivers.

This room knows neither trials nor participants. Libraries of devices are imported only where one is opened. `README.md`
says how to build a rig and how to write a driver, for which the names below are imported lazily.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from palpate.experiment.apparatus.host import elsewhere as elsewhere
    from palpate.experiment.apparatus.ports import Tracker as Tracker
    from palpate.experiment.apparatus.tracker.clock_map import ClockMap as ClockMap
    from palpate.experiment.apparatus.tracker.clock_map import ClockState as ClockState
    from palpate.experiment.apparatus.tracker.clock_map import init as begin_clock  # noqa: F401
    from palpate.experiment.apparatus.tracker.clock_map import step as step_clock  # noqa: F401
    from palpate.experiment.apparatus.tracker.frames import LinkCounts as LinkCounts
    from palpate.experiment.apparatus.tracker.frames import Samples as Samples
    from palpate.experiment.apparatus.tracker.frames import encode as encode
    from palpate.experiment.apparatus.tracker.settings import TrackerRig as TrackerRig
    from palpate.experiment.clock import Clock as Clock
    from palpate.experiment.errors import TrackerError as TrackerError
    from palpate.experiment.errors import TrackerStopped as TrackerStopped

_PLACES = {
    "Clock": "palpate.experiment.clock:Clock",
    "ClockMap": "palpate.experiment.apparatus.tracker.clock_map:ClockMap",
    "ClockState": "palpate.experiment.apparatus.tracker.clock_map:ClockState",
    "LinkCounts": "palpate.experiment.apparatus.tracker.frames:LinkCounts",
    "Samples": "palpate.experiment.apparatus.tracker.frames:Samples",
    "Tracker": "palpate.experiment.apparatus.ports:Tracker",
    "TrackerError": "palpate.experiment.errors:TrackerError",
    "TrackerRig": "palpate.experiment.apparatus.tracker.settings:TrackerRig",
    "TrackerStopped": "palpate.experiment.errors:TrackerStopped",
    "begin_clock": "palpate.experiment.apparatus.tracker.clock_map:init",
    "elsewhere": "palpate.experiment.apparatus.host:elsewhere",
    "encode": "palpate.experiment.apparatus.tracker.frames:encode",
    "step_clock": "palpate.experiment.apparatus.tracker.clock_map:step",
}


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, attribute = _PLACES[name].partition(":")
    return getattr(import_module(module), attribute)
