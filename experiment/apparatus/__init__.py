"""Devices: what a laboratory's rig file names, opened behind small ports (`ports.py`), and their drivers.

A rig file comes in; trackers, actuators, accelerometers, audio streams and maskers go out, each implementing its port,
so that a session knows no make. This room knows neither trials nor participants nor answers. Libraries of devices are
imported where a device is opened, and nowhere else. `README.md` beside this file says how to build and wire a rig and
how to write a driver.

The names below are what a driver needs; they are imported when they are asked for.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from palpate.experiment.apparatus.host import elsewhere as elsewhere
    from palpate.experiment.apparatus.ports import Tracker as Tracker
    from palpate.experiment.apparatus.rig import TrackerRig as TrackerRig
    from palpate.experiment.apparatus.tracker.clock_map import ClockMap as ClockMap
    from palpate.experiment.apparatus.tracker.clock_map import ClockState as ClockState
    from palpate.experiment.apparatus.tracker.clock_map import init as begin_clock  # noqa: F401
    from palpate.experiment.apparatus.tracker.clock_map import step as step_clock  # noqa: F401
    from palpate.experiment.apparatus.tracker.frames import LinkCounts as LinkCounts
    from palpate.experiment.apparatus.tracker.frames import Samples as Samples
    from palpate.experiment.apparatus.tracker.frames import encode as encode
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
    "TrackerRig": "palpate.experiment.apparatus.rig:TrackerRig",
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
