"""Every form of PCM that WAV has, written byte by byte after Microsoft's RIFF (1991, 2001) and EBU Tech 3306 (RF64)."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from palpate.experiment.errors import RecordingError, Remedy
from palpate.experiment.recordings.readers import read
from palpate.experiment.settings.delimited import Stated

PCM, FLOAT, EXTENSIBLE = 1, 3, 0xFFFE
UNKNOWN = 0xFFFFFFFF
LEVELS = [0.0, 0.5, -0.5, 0.25, -1.0, 0.125]
"""Samples as parts of full scale, each of which all forms hold without rounding."""


def _stored(form: int, bits: int, order: str) -> bytes:
    if form == FLOAT:
        return struct.pack(f"{order}{len(LEVELS)}{'f' if bits == 32 else 'd'}", *LEVELS)
    counts = [int(one * 2 ** (bits - 1)) + (128 if bits == 8 else 0) for one in LEVELS]
    little = [one.to_bytes(bits // 8, "little", signed=bits > 8) for one in counts]
    return b"".join(one[::-1] if order == ">" else one for one in little)


def _wav(
    form: int = PCM,
    bits: int = 16,
    *,
    rate: int = 4000,
    size: int | None = None,
    name: bytes = b"RIFF",
    wide: bool = False,
) -> bytes:
    order = ">" if name == b"RIFX" else "<"
    data = _stored(form, bits, order)
    about = struct.pack(f"{order}HHIIHH", EXTENSIBLE if wide else form, 1, rate, rate * bits // 8, bits // 8, bits)
    if wide:
        guid = struct.pack("<I", form) + bytes.fromhex("00001000800000AA00389B71")
        about += struct.pack(f"{order}HHI", 22, bits, 4) + guid
    long = (
        struct.pack("<4sIQQQI", b"ds64", 28, 56 + len(about) + len(data), len(data), len(LEVELS), 0)
        if name == b"RF64"
        else b""
    )
    stated = UNKNOWN if name == b"RF64" else len(data) if size is None else size
    chunks = b"WAVE" + long + b"fmt " + struct.pack(f"{order}I", len(about)) + about
    chunks += b"data" + struct.pack(f"{order}I", stated) + data
    whole = UNKNOWN if name == b"RF64" else len(chunks) if size is None else size
    return name + struct.pack(f"{order}I", whole) + chunks


# The order of a GUID's bytes in RIFX is not defined.
@pytest.mark.parametrize(
    ("name", "wide"), [(b"RIFF", False), (b"RIFF", True), (b"RF64", False), (b"RF64", True), (b"RIFX", False)]
)
@pytest.mark.parametrize(("form", "bits"), [(PCM, 8), (PCM, 16), (PCM, 24), (PCM, 32), (FLOAT, 32), (FLOAT, 64)])
def test_a_form_is_read_as_it_was_written(tmp_path: Path, form: int, bits: int, name: bytes, *, wide: bool) -> None:
    path = tmp_path / "tap.wav"
    path.write_bytes(_wav(form, bits, name=name, wide=wide))
    made = read(path)
    assert (made.rate_hz, made.unit) == (4000.0, "full scale" if form == PCM else "")
    np.testing.assert_array_equal(made.samples, LEVELS)


@pytest.mark.parametrize("size", [0, UNKNOWN])
@pytest.mark.parametrize(("form", "bits", "wide"), [(PCM, 16, False), (PCM, 24, True), (FLOAT, 64, False)])
def test_a_header_that_was_not_finished_is_completed_and_told(
    tmp_path: Path, form: int, bits: int, size: int, *, wide: bool
) -> None:
    path = tmp_path / "tap.wav"
    path.write_bytes(_wav(form, bits, size=size, wide=wide))
    made = read(path)
    np.testing.assert_array_equal(made.samples, LEVELS)
    assert [doubt.check for doubt in made.doubts] == ["unfinished"]


def test_a_header_without_a_rate_asks_for_it(tmp_path: Path) -> None:
    path = tmp_path / "tap.wav"
    path.write_bytes(_wav(rate=0))
    with pytest.raises(RecordingError) as refused:
        read(path, stated=Stated(command=("palpate",)))
    assert isinstance(refused.value.finding.remedy, Remedy)
    assert refused.value.finding.remedy.command == ("palpate", "--rate", "HZ")
    assert read(path, stated=Stated(rate_hz=4000.5)).rate_hz == 4000.5


def test_a_rate_that_is_implausible_is_doubted_until_another_is_stated(tmp_path: Path) -> None:
    path = tmp_path / "tap.wav"
    path.write_bytes(_wav(rate=4))
    assert [doubt.check for doubt in read(path).doubts] == ["rate"]
    made = read(path, stated=Stated(rate_hz=4000))
    assert (made.rate_hz, made.header_rate_hz, made.doubts) == (4000.0, 4.0, ())


def test_a_section_of_a_sound_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "tap.wav"
    path.write_bytes(_wav())
    with pytest.raises(RecordingError):
        read(path, stated=Stated(section="1"))
