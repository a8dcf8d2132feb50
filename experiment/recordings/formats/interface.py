"""What a binary format of recordings supplies, and what all of them refuse alike."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.errors import RecordingError
from palpate.experiment.settings.delimited import LARGEST

SCALES = frozenset(("scale", "gain", "scaling", "calibration", "slope", "sensitivity", "conversion"))
"""Names, in small letters, of what may scale the numbers beside it: nobody knows how."""

RATES = frozenset(
    ("fs", "rate", "rate_hz", "samplerate", "sample_rate", "samplingrate", "sampling_rate", "srate", "fsample",
     "samplingfrequency", "sampling_frequency", "sfreq")
)  # fmt: skip
STEPS = frozenset(("dt", "delta_t", "sample_interval", "sampleinterval", "tsample"))
"""Names, in small letters, under which a file states the sampling rate in Hz, and the time between samples in s."""


class Channel(NamedTuple):
    """A channel: its values, shape (n,), their unit, empty without one, and the time between them, s, NaN without.

    `dimension` is what it stands over, `Time` for a recording.
    """

    name: str
    values: NDArray[Any]
    unit: str = ""
    step_s: float = np.nan
    dimension: str = "Time"


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
            f"got a file of {name}, and {package} is not installed", remedy="install it: pip install 'palpate[files]'"
        ) from error


def refuse_large(numbers: Iterable[int], name: str) -> None:
    """Refuse a file that would unpack to more than `LARGEST` bytes, as numbers of 8 bytes."""
    if (all_bytes := 8 * sum(numbers)) > LARGEST:
        raise RecordingError(
            f"got a file of {name} with {all_bytes / 2**20:.0f} MiB of numbers",
            remedy="export a part of it",
            allowed=f"at most {LARGEST // 2**20} MiB",
        )


def channels_of(name: str, values: NDArray[Any], unit: str = "", step_s: float = np.nan) -> list[Channel]:
    """Return the channels in an array: one, or one for each row or column of two dimensions, whichever are fewer."""
    if values.dtype.kind == "b":
        values = values.astype(np.int8)
    flat = np.squeeze(values)
    if flat.dtype.kind not in "iuf" or flat.ndim not in (1, 2) or flat.size < 2:
        return []
    if flat.ndim == 1:
        return [Channel(name, flat, unit, step_s)]
    by_column = flat if flat.shape[0] >= flat.shape[1] else flat.T
    return [Channel(f"{name} {k + 1}", by_column[:, k], unit, step_s) for k in range(by_column.shape[1])]


def nearest(group: str, steps: Mapping[str, float]) -> float:
    """Return the step, s, that a group states, or else the nearest group around it; NaN where none does.

    Groups are paths with slashes; that of the file is empty.
    """
    while group and group not in steps:
        group = group.rpartition("/")[0]
    return steps.get(group, np.nan)


def stated_step_s(name: str, value: object) -> float:
    """Return the time between samples that a number of this name states, s; NaN where it states none."""
    try:
        number = float(np.asarray(value).reshape(-1)[0]) if np.size(np.asarray(value)) == 1 else np.nan
    except (TypeError, ValueError):
        return np.nan
    if not (np.isfinite(number) and number > 0):
        return np.nan
    bare = name.lower().replace(" ", "_")
    return 1 / number if bare in RATES else number if bare in STEPS else np.nan
