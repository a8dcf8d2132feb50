"""HDF5, and MAT 7.3, which is HDF5: each dataset of one or two dimensions is channels.

Rates stand in attributes of a dataset, its groups or the file, or in datasets of one number. What leads to other files
(links, external and virtual datasets) is not followed.
"""

import io
from collections.abc import Mapping
from typing import Any

import numpy as np

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.formats.interface import (
    SCALES,
    Channel,
    Format,
    Step,
    channels_of,
    nearest,
    needed,
    refuse_large,
    stated_step,
    unit_beside,
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
            steps = {name.rpartition("/")[0]: step for name, one in held if (step := _step(name, one)) is not None}
            for group in {group.name: group for _, one in held for group in _groups(one)}.values():
                if (step := _of_attributes(group)) is not None:
                    steps[group.name.strip("/")] = step
            scales = {one.name: name for name, one in held}
            found = []
            for name, one in held:
                units = next((_texts(one.attrs[key]) for key in UNITS if key in one.attrs), [""])
                step = _of_attributes(one) or nearest(name.rpartition("/")[0], steps)
                channels = channels_of(name, _scaled(name, one), units[0] if len(units) == 1 else "", step)
                own_units = units if len(units) == len(channels) else [channel.unit for channel in channels]
                over = _scale_name(one, scales)
                found += [
                    channel._replace(unit=unit, over=over) for channel, unit in zip(channels, own_units, strict=True)
                ]
    except (OSError, ValueError, KeyError, RuntimeError, OverflowError) as error:
        raise RecordingError(
            f"the {NAME} file is damaged ({error})", remedy="export it again", allowed="an undamaged file"
        ) from error
    return found, ""


def _scaled(name: str, one: Any) -> Any:
    """Return what a dataset holds, by the scale and offset of the CF conventions (8.1), if it states them.

    Raises `RecordingError` for a scale of another name, of which nobody knows what it does.
    """
    other = next((key for key in one.attrs if key.lower() in SCALES), None)
    if other is not None:
        raise RecordingError(
            f"got {name} with the attribute {other!r}, which may be a scale factor",
            remedy="export physical values, or rename the attribute",
            allowed="scale_factor and add_offset",
        )
    factor, offset = (one.attrs.get(key, usual) for key, usual in (("scale_factor", 1), ("add_offset", 0)))
    values, fill = one[()], one.attrs.get("_FillValue")
    if fill is not None and np.size(fill) == 1 and one.size > 1:
        # What is filled in stands for a missing sample, before it is scaled.
        values = np.where(values == np.reshape(fill, ()), np.nan, values) if np.any(values == fill) else values
    return values if (factor, offset) == (1, 0) else values * float(factor) + float(offset)


def _scale_name(one: Any, scales: Mapping[str, str]) -> str:
    """Return the name of the dataset that is the scale of a dataset's longest dimension; empty without one."""
    if one.ndim not in (1, 2) or one.is_scale:
        return ""
    along = one.dims[int(np.argmax(one.shape))]
    return next((scales[held.name] for held in along.values() if held.name in scales), "")


def _is_own(h5py: Any, one: Any) -> bool:
    return isinstance(one, h5py.Dataset) and one.dtype.kind in "biuf" and not one.is_virtual and not one.external


def _groups(one: Any) -> list[Any]:
    found = []
    while one.name != "/":
        one = one.parent
        found.append(one)
    return found


def _of_attributes(one: Any) -> Step | None:
    texts = {key: _texts(value)[0] for key, value in one.attrs.items() if np.size(value) == 1}
    steps = (stated_step(key, value, unit_beside(key, texts)) for key, value in one.attrs.items())
    return next((step for step in steps if step is not None), None)


def _step(name: str, one: Any) -> Step | None:
    if one.size != 1:
        return None
    units = next((_texts(one.attrs[key]) for key in UNITS if key in one.attrs), [""])
    return stated_step(name.rpartition("/")[2], one[()], units[0])


def _texts(value: Any) -> list[str]:
    every = np.asarray(value).reshape(-1).tolist()
    return [one.decode("utf-8", "replace") if isinstance(one, bytes) else str(one) for one in every]


FORMAT = Format(NAME, (b"\x89HDF\r\n\x1a\n", b"MATLAB 7.3 MAT-file"), read)
