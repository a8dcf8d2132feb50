"""HDF5, and MAT 7.3, which is HDF5: each dataset of one or two dimensions is channels.

Rates stand in attributes of a dataset, its groups or the file, or in datasets of one number. What leads to other files
(links, external and virtual datasets) is not followed.
"""

import io
from typing import Any

import numpy as np

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.formats.interface import (
    SCALES,
    Channel,
    Format,
    channels_of,
    nearest,
    needed,
    refuse_large,
    stated_step_s,
)

NAME = "HDF5"
UNITS = ("unit", "units", "unit_string", "Unit", "Units")


def read(content: bytes) -> tuple[list[Channel], str]:
    """Return the channels of a file. Raises `RecordingError` for one that is damaged or too large."""
    h5py = needed("h5py", NAME)
    held: list[tuple[str, Any]] = []
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            file.visititems(lambda name, one: held.append((name, one)) if _is_own(h5py, one) else None)
            refuse_large((one.size for _, one in held), NAME)
            steps = {name.rpartition("/")[0]: step for name, one in held if (step := _step_s(name, one)) > 0}
            for group in {group.name: group for _, one in held for group in _groups(one)}.values():
                if (step := _of_attributes(group)) > 0:
                    steps[group.name.strip("/")] = step
            found = []
            for name, one in held:
                units = next((_texts(one.attrs[key]) for key in UNITS if key in one.attrs), [""])
                own = _of_attributes(one)
                step = own if own > 0 else nearest(name.rpartition("/")[0], steps)
                channels = channels_of(name, _scaled(name, one), units[0] if len(units) == 1 else "", step)
                own_units = units if len(units) == len(channels) else [channel.unit for channel in channels]
                found += [channel._replace(unit=unit) for channel, unit in zip(channels, own_units, strict=True)]
    except (OSError, ValueError, KeyError, RuntimeError, OverflowError) as error:
        raise RecordingError(
            f"got a damaged file of {NAME} ({error})", remedy="export it again", allowed="a whole one"
        ) from error
    return found, ""


def _scaled(name: str, one: Any) -> Any:
    """Return what a dataset holds, by the scale and offset of the CF conventions (8.1), if it states them.

    Raises `RecordingError` for a scale of another name, of which nobody knows what it does.
    """
    other = next((key for key in one.attrs if key.lower() in SCALES), None)
    if other is not None:
        raise RecordingError(
            f"got {name} with the attribute {other!r}, which may scale it",
            remedy="export it in its unit, or name the attributes so",
            allowed="scale_factor and add_offset",
        )
    factor, offset = (one.attrs.get(key, usual) for key, usual in (("scale_factor", 1), ("add_offset", 0)))
    return one[()] if (factor, offset) == (1, 0) else one[()] * float(factor) + float(offset)


def _is_own(h5py: Any, one: Any) -> bool:
    return isinstance(one, h5py.Dataset) and one.dtype.kind in "biuf" and not one.is_virtual and not one.external


def _groups(one: Any) -> list[Any]:
    found = []
    while one.name != "/":
        one = one.parent
        found.append(one)
    return found


def _of_attributes(one: Any) -> float:
    return next((step for key, value in one.attrs.items() if (step := stated_step_s(key, value)) > 0), np.nan)


def _step_s(name: str, one: Any) -> float:
    return stated_step_s(name.rpartition("/")[2], one[()]) if one.size == 1 else np.nan


def _texts(value: Any) -> list[str]:
    every = np.asarray(value).reshape(-1).tolist()
    return [one.decode("utf-8", "replace") if isinstance(one, bytes) else str(one) for one in every]


FORMAT = Format(NAME, (b"\x89HDF\r\n\x1a\n", b"MATLAB 7.3 MAT-file"), read)
