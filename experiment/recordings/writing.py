"""Recordings of materials, written to disk: the files that `manifest.py` reads."""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import wavfile

from experiment import files
from experiment.apparatus.zeroing import Zero
from experiment.errors import RecordingError
from experiment.recordings.manifest import MANIFEST


@dataclass(frozen=True)
class Take:
    """One recording.

    Attributes:
        material: on the panel; None for the bare panel.
        speed_mm_s: target of the foot, mm/s.
        number: from 1, among takes of one condition.
        samples_m_s2: acceleration, m/s^2, shape (N,).
        achieved_mm_s: speed of the foot through the gate, mm/s; None where no tracker saw it.
        zero: where the foot rested before, which its heights count from; None where nothing was zeroed.
    """

    material: str | None
    speed_mm_s: float
    number: int
    samples_m_s2: NDArray[np.float64]
    achieved_mm_s: float | None = None
    zero: Zero | None = None


def write(directory: Path, *, takes: Iterable[Take], rate_hz: int, simulated: bool, label: str, note: str = "") -> Path:
    """Write takes as float32 WAV files with their manifest, all of them on disk when this returns.

    Args:
        directory: to make; it may exist if it is empty.
        takes: all of one length.
        rate_hz: sampling rate of every take, Hz.
        simulated: whether any take was made by a simulation.
        label: what these recordings are, in a few words.
        note: anything more.

    Returns:
        The manifest's path. It is written last: a directory without one was not finished.

    Raises:
        RecordingError: the directory holds anything, the takes differ in length, or a sample is not finite.
    """
    takes = list(takes)
    lengths = sorted({take.samples_m_s2.size for take in takes})
    if len(lengths) != 1:
        raise RecordingError(f"{directory}: got takes of {lengths} samples; allowed: one length; cut them alike")
    for take in takes:
        if not np.all(np.isfinite(take.samples_m_s2)):
            raise RecordingError(f"take {take.number} of {take.material or 'the panel'}: NaN or infinite; record again")
    if directory.exists() and any(directory.iterdir()):
        raise RecordingError(f"{directory}: holds files already; allowed: a new or empty directory; choose another")
    directory.mkdir(parents=True, exist_ok=True)
    lines = [
        "format = 1",
        f"label = {_toml(label)}",
        f"note = {_toml(note)}",
        f"simulated = {'true' if simulated else 'false'}",
        f"rate_hz = {rate_hz}",
        f"samples = {lengths[0]}",
        'unit = "m/s^2"',
    ]
    for place, take in enumerate(takes):
        slug = re.sub(r"[^a-z0-9]+", "_", (take.material or "panel").lower())
        file = f"{place:03d}_{slug}_{take.speed_mm_s:g}_{take.number}.wav"
        buffer = io.BytesIO()
        wavfile.write(buffer, rate_hz, take.samples_m_s2.astype(np.float32))
        files.write(directory / file, buffer.getvalue())
        lines += ["", "[[takes]]", f"file = {_toml(file)}"]
        if take.material is not None:
            lines.append(f"material = {_toml(take.material)}")
        lines.append(f"speed_mm_s = {float(take.speed_mm_s)!r}")
        if take.achieved_mm_s is not None:
            lines.append(f"achieved_mm_s = {float(take.achieved_mm_s)!r}")
        if (zero := take.zero) is not None:
            offset_mm, spread_mm = float(zero.offset_mm), float(zero.spread_mm)
            lines.append(f"zero = {{ offset_mm = {offset_mm!r}, spread_mm = {spread_mm!r}, samples = {zero.samples} }}")
        lines += [
            f"number = {take.number}",
            f'sha256 = "{hashlib.sha256(buffer.getvalue()).hexdigest()}"',
        ]
    manifest = directory / MANIFEST
    files.write(manifest, ("\n".join(lines) + "\n").encode())
    return manifest


def _toml(text: str) -> str:
    """A TOML basic string; JSON escapes all that TOML wants escaped, but for DEL."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
