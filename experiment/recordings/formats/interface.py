"""What a binary format of recordings supplies, and what all of them refuse alike."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import RecordingError
from palpate.experiment.settings.delimited import LARGEST
from palpate.experiment.settings.units import SECONDS, Heading, time_unit

SCALES = frozenset(("scale", "gain", "scaling", "calibration", "slope", "sensitivity", "conversion"))
"""Names, in small letters, of what may scale the numbers beside it: nobody knows how."""

RATES = frozenset(
    ("fs", "f_s", "sr", "rate", "samplerate", "sample_rate", "samplingrate", "sampling_rate", "srate", "fsample",
     "samplingfrequency", "sampling_frequency", "samplefrequency", "sample_frequency", "sfreq", "scan_rate")
)  # fmt: skip
STEPS = frozenset(
    ("dt", "delta_t", "deltat", "sample_interval", "sampleinterval", "sampling_interval", "samplinginterval", "tsample",
     "t_sample", "tinterval", "sample_period", "sampleperiod", "sampling_period", "samplingperiod", "sample_time",
     "time_step", "timestep")
)  # fmt: skip
"""Names, in small letters, under which a file states the sampling rate, and the time between samples."""

HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "1/s": 1.0, "s^-1": 1.0, "s/s": 1.0, "ks/s": 1e3, "sps": 1.0, "ksps": 1e3}
"""Hertz in a unit of rates, in small letters."""


class Step(NamedTuple):
    """The time between samples: in s, or `bare`, in a unit that nothing states; NaN for neither."""

    s: float = np.nan
    bare: float = np.nan


NO_STEP = Step()


class Channel(NamedTuple):
    """A channel: its values, shape (n,), their unit, empty without one, and the time between them, s, NaN without.

    `bare_step` is a time between them in a unit that nothing states. `dimension` is what it stands over, `Time` for a
    recording, and `over` the name of the channel that holds it, where the file says so.
    """

    name: str
    values: NDArray[Any]
    unit: str = ""
    step_s: float = np.nan
    dimension: str = "Time"
    bare_step: float = np.nan
    over: str = ""


@dataclass(frozen=True)
class Format:
    """A format: how its files begin, and what reads the channels of one, and says why it is doubtful, if it is.

    `read` raises `RecordingError`.
    """

    name: str
    begins: tuple[bytes, ...]
    read: Callable[[bytes], tuple[list[Channel], str]]


def needed(package: str, name: str) -> Any:
    """Return a package of the extra `files`. Raises `RecordingError` where it is missing."""
    try:
        return import_module(package)
    except ImportError as error:
        raise RecordingError(
            f"got a {name} file, but {package} is not installed", remedy="install it: pip install 'palpate[files]'"
        ) from error


def refuse_large(numbers: Iterable[int], name: str) -> None:
    """Refuse a file that would unpack to more than `LARGEST` bytes, as numbers of 8 bytes."""
    if (all_bytes := 8 * sum(numbers)) > LARGEST:
        raise RecordingError(
            f"got a {name} file with {all_bytes / 2**20:.0f} MiB of numbers",
            remedy="export part of it",
            allowed=f"at most {LARGEST // 2**20} MiB",
        )


def channels_of(name: str, values: NDArray[Any], unit: str = "", step: Step = NO_STEP) -> list[Channel]:
    """Return the channels in an array: one, or one for each row or column of two dimensions, whichever are fewer."""
    if values.dtype.kind == "b":
        values = values.astype(np.int8)
    flat = np.squeeze(values)
    rates = name.rpartition("/")[2].lower() in RATES
    if rates or flat.dtype.kind not in "iuf" or flat.ndim not in (1, 2) or flat.size < 2:
        return []
    if flat.ndim == 1:
        return [Channel(name, flat, unit, step.s, bare_step=step.bare)]
    by_column = flat if flat.shape[0] >= flat.shape[1] else flat.T
    return [
        Channel(f"{name} {k + 1}", by_column[:, k], unit, step.s, bare_step=step.bare)
        for k in range(by_column.shape[1])
    ]


def nearest(group: str, steps: Mapping[str, Step]) -> Step:
    """Return the step that a group states, or else the nearest group around it.

    Groups are paths with slashes; that of the file is empty.
    """
    while group and group not in steps:
        group = group.rpartition("/")[0]
    return steps.get(group, NO_STEP)


def stated_step(name: str, value: object, unit: str = "") -> Step | None:
    """Return the time between samples that a number of this name states; None where it states none.

    Its unit is the one beside it, or the end of its name (`fs_kHz`, `dt_ms`); a rate without one is in hertz.
    """
    try:
        number = float(np.asarray(value).reshape(-1)[0]) if np.size(np.asarray(value)) == 1 else np.nan
    except (TypeError, ValueError):
        return None
    if not (np.isfinite(number) and number > 0):
        return None
    bare = name.lower().replace(" ", "_").replace("(", "").replace(")", "")
    rest, _, end = bare.rpartition("_")
    own = unit.strip().lower()
    if bare in RATES or (rest in RATES and end in HERTZ):
        factor = HERTZ.get(own or (end if rest in RATES and end in HERTZ else "hz"), 0.0)
        return Step(1 / (number * factor)) if factor else None
    if bare in STEPS:
        known = time_unit(Heading("", own)) if own else ""
        return Step(number * SECONDS[known]) if known else Step(bare=number)
    if rest in STEPS and (known := time_unit(Heading("", end))):
        return Step(number * SECONDS[known])
    return None


def unit_beside(name: str, texts: Mapping[str, str]) -> str:
    """Return the unit that a text beside a number of this name states, such as `fs_unit`; empty without one."""
    ends = ("_unit", "_units", "unit", "units", " unit")
    return next((texts[f"{name}{end}"] for end in ends if f"{name}{end}" in texts), "")
