"""TDMS, HDF5 and MAT files, written by the libraries of their formats."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import nptdms
import numpy as np
import pytest
from scipy.io import savemat

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.formats import AUDIO, FORMATS, format_of, interface
from palpate.experiment.recordings.readers import read
from palpate.experiment.settings.delimited import Stated

RATE_HZ = 3200.0
TIMES_S = np.arange(400) / RATE_HZ
SAMPLES = np.round(3.0 * np.sin(2 * np.pi * 100.0 * TIMES_S), 6)


def tdms(path: Path, *, rate: bool = True) -> None:
    about = {"wf_increment": 1 / RATE_HZ, "unit_string": "g"} if rate else {"unit_string": "g"}
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment([nptdms.ChannelObject("taps", "acceleration", SAMPLES, properties=about)])


def hdf5(path: Path, *, rate: bool = True) -> None:
    with h5py.File(path, "w") as file:
        file["taps/acceleration"] = SAMPLES
        file["taps/acceleration"].attrs["unit"] = "g"
        if rate:
            file["taps"].attrs["sampling_rate"] = RATE_HZ


def mat(path: Path, *, rate: bool = True) -> None:
    savemat(path, {"acceleration": SAMPLES, **({"Fs": RATE_HZ} if rate else {})})


WRITERS: dict[str, Callable[..., None]] = {"tdms": tdms, "hdf5": hdf5, "mat": mat}


@pytest.mark.parametrize("name", FORMATS)
def test_a_channel_has_the_rate_and_the_unit_that_its_file_states(tmp_path: Path, name: str) -> None:
    path = tmp_path / "recording"
    WRITERS[name](path)
    made = read(path)
    np.testing.assert_array_equal(made.samples, SAMPLES)
    assert made.rate_hz == pytest.approx(RATE_HZ, rel=1e-12)
    assert made.unit == ("" if name == "mat" else "g")
    WRITERS[name](path, rate=False)
    with pytest.raises(RecordingError):
        read(path)


@pytest.mark.parametrize("name", FORMATS)
def test_a_damaged_file_and_one_that_would_fill_memory_are_refused(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "recording"
    WRITERS[name](path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 3])
    if name == "tdms":
        made = read(path)
        assert [doubt.check for doubt in made.doubts] == ["unfinished"]
        np.testing.assert_array_equal(made.samples, SAMPLES[: made.samples.size])
    else:
        with pytest.raises(RecordingError):
            read(path)
    path.write_bytes(whole)
    monkeypatch.setattr(interface, "LARGEST", 1000)
    with pytest.raises(RecordingError, match="MiB"):
        read(path)


def test_a_package_that_is_not_installed_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "recording"
    tdms(path)
    monkeypatch.setitem(sys.modules, "nptdms", None)
    with pytest.raises(RecordingError) as refused:
        read(path)
    assert "palpate[files]" in str(refused.value.finding.remedy)


def test_a_clock_among_the_channels_counts_and_a_rate_where_its_unit_is_not_said(tmp_path: Path) -> None:
    path = tmp_path / "recording.mat"
    savemat(path, {"t": 1e3 * TIMES_S, "acceleration": SAMPLES})
    with pytest.raises(RecordingError):
        read(path)
    assert read(path, stated=Stated(time_unit="ms")).rate_hz == pytest.approx(RATE_HZ)
    savemat(path, {"t": 1e3 * TIMES_S, "acceleration": SAMPLES, "fs": RATE_HZ})
    assert (read(path).rate_hz, read(path).channels) == (RATE_HZ, ("acceleration",))
    savemat(path, {"data": np.stack([TIMES_S, SAMPLES, -SAMPLES], axis=1)})
    made = read(path, channel="data 3", stated=Stated(time_column="data 1", time_unit="s"))
    np.testing.assert_array_equal(made.samples, -SAMPLES)
    assert made.rate_hz == pytest.approx(RATE_HZ)


def test_several_groups_keep_their_clocks(tmp_path: Path) -> None:
    path = tmp_path / "recording.h5"
    with h5py.File(path, "w") as file:
        for group, rate_hz in (("slow", 1000.0), ("fast", 8000.0)):
            file[f"{group}/time (ms)"] = 1e3 * np.arange(400) / rate_hz
            file[f"{group}/force"] = SAMPLES
    assert {one: read(path, channel=f"{one}/force").rate_hz for one in ("slow", "fast")} == pytest.approx(
        {"slow": 1000.0, "fast": 8000.0}
    )


def test_nothing_of_another_file_is_read(tmp_path: Path) -> None:
    hdf5(tmp_path / "secret.h5")
    path = tmp_path / "recording.h5"
    with h5py.File(path, "w") as file:
        file["linked"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "/taps/acceleration")
        layout = h5py.VirtualLayout(shape=SAMPLES.shape, dtype="f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "secret.h5"), "taps/acceleration", shape=SAMPLES.shape)
        file.create_virtual_dataset("virtual", layout)
    with pytest.raises(RecordingError, match="without numeric arrays"):
        read(path)


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kind", ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"])
def test_numbers_of_every_kind_are_those_that_scipy_wrote(tmp_path: Path, kind: str, compressed: bool) -> None:
    path = tmp_path / "recording.mat"
    numbers = np.arange(100).astype(kind)
    savemat(path, {"fs": 100.0, "x": numbers, "many": np.stack([numbers, numbers])}, do_compression=compressed)
    made = read(path, channel="many 2")
    assert made.channels == ("x", "many 1", "many 2")
    np.testing.assert_array_equal(made.samples, numbers.astype(float))
    assert made.rate_hz == 100.0


@pytest.mark.parametrize(
    "held",
    [
        {"trials": np.array([(SAMPLES,), (SAMPLES,)], dtype=[("acc", object)])},
        {"cells": np.array([1, "a"], dtype=object)},
    ],
    ids=["array of structures", "cells"],
)
def test_arrays_of_structures_and_cells_stay_closed(tmp_path: Path, held: dict[str, Any]) -> None:
    path = tmp_path / "recording.mat"
    savemat(path, held)
    with pytest.raises(RecordingError) as refused:
        read(path)
    assert next(iter(held)) in str(refused.value)


def test_samples_that_are_no_numbers_are_named(tmp_path: Path) -> None:
    path = tmp_path / "recording.mat"
    savemat(path, {"fs": RATE_HZ, "acceleration": np.where(TIMES_S == 0.0, np.nan, SAMPLES)})
    with pytest.raises(RecordingError, match="sample 1"):
        read(path)
    assert format_of(io.BytesIO(b"time,a").read()) is None


@pytest.mark.parametrize("compressed", [False, True])
def test_fields_of_structures_are_channels_with_the_rate_of_their_own_structure(
    tmp_path: Path, compressed: bool
) -> None:
    path = tmp_path / "recording.mat"
    slow = {"acc": SAMPLES[::2], "Fs": RATE_HZ / 2, "note": "x", "none": [], "cells": np.array([1, "a"], dtype=object)}
    inner = {"acc": SAMPLES, "Fs": RATE_HZ}
    savemat(path, {"slow": slow, "outer": {"fast": inner, "n": 3}}, do_compression=compressed)
    made = read(path, channel="outer/fast/acc")
    np.testing.assert_array_equal(made.samples, SAMPLES)
    assert made.channels == ("slow/acc", "outer/fast/acc")
    assert made.rate_hz == pytest.approx(RATE_HZ)
    assert read(path, channel="slow/acc").rate_hz == pytest.approx(RATE_HZ / 2)


def test_times_in_a_structure_are_those_of_its_samples(tmp_path: Path) -> None:
    path = tmp_path / "recording.mat"
    savemat(path, {"trial": {"time": TIMES_S, "acc": SAMPLES}})
    made = read(path, stated=Stated(time_unit="s"))
    assert made.channel == "trial/acc"
    assert made.rate_hz == pytest.approx(RATE_HZ)


@pytest.mark.parametrize("name", ["mat", "hdf5"])
def test_times_beside_a_rate_that_says_otherwise_are_asked_about_and_those_that_keep_it_are_the_clock(
    tmp_path: Path, name: str
) -> None:
    path = tmp_path / "recording"

    def write(rate_hz: float) -> None:
        if name == "mat":
            savemat(path, {"time": TIMES_S * 1000, "acc": SAMPLES, "fs": rate_hz})
        else:
            with h5py.File(path, "w") as file:
                file["time"], file["acc"] = TIMES_S * 1000, SAMPLES
                file.attrs["sampling_rate"] = rate_hz

    write(RATE_HZ)
    made = read(path)
    assert made.rate_source == "time column 'time'"
    assert made.header_rate_hz == pytest.approx(RATE_HZ)
    write(RATE_HZ * 0.7)
    with pytest.raises(RecordingError) as refused:
        read(path)
    assert "without a unit" in refused.value.finding.what


def test_numbers_that_are_stored_scaled_are_in_their_unit_and_a_scale_of_another_name_is_refused(
    tmp_path: Path,
) -> None:
    path = tmp_path / "recording"
    with h5py.File(path, "w") as file:
        file["acc"] = np.round(4096 * SAMPLES).astype(np.int16)
        file["acc"].attrs.update({"scale_factor": 1 / 4096, "add_offset": 0.5, "units": "g", "sampling_rate": RATE_HZ})
    assert read(path).samples == pytest.approx(SAMPLES + 0.5, abs=2e-4)
    with h5py.File(path, "a") as file:
        file["acc"].attrs["gain"] = 2.0
    with pytest.raises(RecordingError) as refused:
        read(path)
    assert "'gain'" in refused.value.finding.what


def test_the_unit_that_a_structure_states_is_that_of_its_samples_and_of_no_clock(tmp_path: Path) -> None:
    path = tmp_path / "recording.mat"
    savemat(path, {"rec": {"acc": SAMPLES, "t": TIMES_S, "unit": "m/s²"}, "other": {"x": SAMPLES, "units": "g"}})
    stated = Stated(time_unit="s")
    assert [read(path, channel=name, stated=stated).unit for name in ("rec/acc", "other/x")] == ["m/s²", "g"]


def test_a_rate_is_that_of_its_own_structure_or_group_and_of_those_within(tmp_path: Path) -> None:
    path = tmp_path / "recording"
    savemat(path, {"imu": {"gyro": SAMPLES, "fs": 100.0, "inner": {"x": SAMPLES}}, "force": SAMPLES})
    assert [read(path, channel=name).rate_hz for name in ("imu/gyro", "imu/inner/x")] == pytest.approx([100.0, 100.0])
    with pytest.raises(RecordingError) as refused:
        read(path, channel="force")
    assert refused.value.finding.allowed.startswith("a time column")
    path.unlink()
    with h5py.File(path, "w") as file:
        file.attrs["fs"] = 500.0
        for run, rate_hz in (("run1", 1000.0), ("run10", 2000.0)):
            file[f"{run}/acc"], file[f"{run}/fs"] = SAMPLES, rate_hz
        file["acc"] = SAMPLES
    rates = [read(path, channel=name).rate_hz for name in ("run1/acc", "run10/acc", "acc")]
    assert rates == pytest.approx([1000.0, 2000.0, 500.0])


def test_the_increment_of_a_waveform_is_in_its_own_unit_and_over_time_alone(tmp_path: Path) -> None:
    def written(over: str, unit: str, step: float) -> Path:
        about = {"wf_increment": step, "wf_xname": over, "wf_xunit_string": unit}
        with nptdms.TdmsWriter(str(tmp_path / f"{unit}.tdms")) as writer:
            writer.write_segment([nptdms.ChannelObject("taps", "acceleration", SAMPLES, properties=about)])
        return tmp_path / f"{unit}.tdms"

    for over, unit, step in (("Time", "ms", 0.3125), ("", "us", 312.5), ("Time", "s", 1 / RATE_HZ)):
        assert read(written(over, unit, step)).rate_hz == pytest.approx(RATE_HZ, rel=1e-12)
    for over, unit in (("Frequency", "Hz"), ("", "Hz"), ("Time", "samples")):
        with pytest.raises(RecordingError):
            read(written(over, unit, 8.0))


def test_a_structure_with_the_name_of_a_unit_says_none_and_a_unit_of_time_is_that_of_its_clock(tmp_path: Path) -> None:
    path = tmp_path / "taps.mat"
    savemat(path, {"S": {"time": TIMES_S * 1e3, "acc": SAMPLES}})
    with pytest.raises(RecordingError):
        read(path)
    savemat(path, {"S": {"time": TIMES_S * 1e3, "acc": SAMPLES, "unit": "ms"}})
    made = read(path)
    assert made.rate_hz == pytest.approx(RATE_HZ)
    assert made.unit == ""


def test_whole_numbers_beside_a_scale_of_their_own_are_refused(tmp_path: Path) -> None:
    path, counts = tmp_path / "taps.mat", np.round(SAMPLES * 1e4).astype(np.int16)
    savemat(path, {"acc": counts, "scale": 1e-4, "fs": RATE_HZ})
    with pytest.raises(RecordingError):
        read(path)
    savemat(path, {"acc": SAMPLES, "scale": 1e-4, "fs": RATE_HZ})
    np.testing.assert_array_equal(read(path).samples, SAMPLES)


def test_each_column_of_a_dataset_has_the_unit_that_stands_for_it(tmp_path: Path) -> None:
    path = tmp_path / "taps.h5"
    with h5py.File(path, "w") as file:
        file["data"] = np.column_stack([SAMPLES, 2 * SAMPLES])
        file["data"].attrs["units"] = ["g", "N"]
        file["data"].attrs["fs"] = RATE_HZ
    assert [read(path, channel=one).unit for one in ("1", "2")] == ["g", "N"]


def test_a_rate_of_a_header_that_is_implausible_is_a_doubt(tmp_path: Path) -> None:
    savemat(tmp_path / "taps.mat", {"acc": SAMPLES, "dt_s": 0.3125})
    assert [doubt.check for doubt in read(tmp_path / "taps.mat").doubts] == ["rate"]


@pytest.mark.parametrize(
    "held", [{"fs_kHz": 3.2}, {"fs": 3.2, "fs_unit": "kHz"}, {"dt": 0.3125, "dt_unit": "ms"}, {"dt_us": 312.5}]
)
def test_a_rate_or_step_has_the_unit_in_its_name_or_beside_it(tmp_path: Path, held: dict[str, Any]) -> None:
    savemat(tmp_path / "taps.mat", {"acc": SAMPLES, **held})
    with h5py.File(tmp_path / "taps.h5", "w") as file:
        file["acc"] = SAMPLES
        file["acc"].attrs.update(held)
    made = [read(tmp_path / name).rate_hz for name in ("taps.mat", "taps.h5")]
    assert made == [pytest.approx(RATE_HZ)] * 2


def test_a_step_without_a_unit_is_asked_about(tmp_path: Path) -> None:
    savemat(tmp_path / "taps.mat", {"acc": SAMPLES, "dt": 0.3125})
    with pytest.raises(RecordingError) as refused:
        read(tmp_path / "taps.mat")
    assert "--time-unit ms" in str(refused.value.finding.remedy)
    assert read(tmp_path / "taps.mat", stated=Stated(time_unit="ms")).rate_hz == pytest.approx(RATE_HZ)


def test_the_scale_of_a_dimension_is_the_clock_of_its_channel(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "taps.h5", "w") as file:
        file["acc"], file["force"] = SAMPLES, SAMPLES
        for name, channel, step in (("axis", "acc", 0.3125), ("time", "force", 1.0)):
            file[name] = np.arange(SAMPLES.size) * step
            file[name].attrs["units"] = "milliseconds since 2024-03-12"
            file[name].make_scale(name)
            file[channel].dims[0].attach_scale(file[name])
    made = {name: read(tmp_path / "taps.h5", channel=name) for name in ("acc", "force")}
    assert {name: (round(one.rate_hz, 6), one.channels) for name, one in made.items()} == {
        "acc": (RATE_HZ, ("acc", "force")), "force": (1000.0, ("acc", "force")),
    }  # fmt: skip


def test_what_is_filled_in_is_missing_and_bridged_on_request(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "taps.h5", "w") as file:
        file["acc"] = np.where(np.isin(np.arange(SAMPLES.size), (100, 101)), -999.0, SAMPLES)
        file["acc"].attrs.update({"fs": RATE_HZ, "_FillValue": -999.0})
    with pytest.raises(RecordingError, match="--resample"):
        read(tmp_path / "taps.h5")
    made = read(tmp_path / "taps.h5", stated=Stated(resample=True))
    assert (made.samples.size, [doubt.check for doubt in made.doubts]) == (SAMPLES.size, ["resampled"])
    np.testing.assert_allclose(made.samples, SAMPLES, atol=0.02)


@pytest.mark.parametrize("begins", AUDIO)
def test_sound_of_other_formats_is_refused_with_a_command_that_converts_it(tmp_path: Path, begins: bytes) -> None:
    (tmp_path / "taps.bin").write_bytes(begins + bytes(100))
    with pytest.raises(RecordingError, match="ffmpeg -i"):
        read(tmp_path / "taps.bin")
