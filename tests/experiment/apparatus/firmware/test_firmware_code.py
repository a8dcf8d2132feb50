"""What the tracker's firmware computes, compiled for this machine: its frames, and the passages that its lamp judges.

How the chip runs it is in tests/rig/test_firmware.py.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.apparatus.tracker.frames import FRAME_BYTES, Samples, encode
from palpate.experiment.apparatus.tracker.gate import Gate, GateDetector
from palpate.experiment.protocol.models import Step
from palpate.experiment.rehearsal.wires.foot import trajectory
from tests.conftest import REPOSITORY

FIRMWARE = REPOSITORY / "experiment" / "apparatus" / "firmware"
WRAP_US = 2**32
TOP, BOTTOM = 246, 164


class CGate(ctypes.Structure):
    _fields_ = (("top", ctypes.c_uint16), ("bottom", ctypes.c_uint16))


class CPassage(ctypes.Structure):
    _fields_ = (
        ("begun", ctypes.c_bool),
        ("in_gate", ctypes.c_bool),
        ("counts", ctypes.c_uint16),
        ("device_us", ctypes.c_uint32),
        ("top_us", ctypes.c_uint32),
    )


@pytest.fixture(scope="module")
def code(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    if shutil.which("gcc") is None:
        pytest.skip("needs gcc")
    library = tmp_path_factory.mktemp("code") / "code.so"
    flags = ["-std=c11", "-O1", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-shared", "-fPIC"]
    sources = [FIRMWARE / "frame.c", FIRMWARE / "passage.c"]
    done = subprocess.run(["gcc", *flags, "-o", library, *sources], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    loaded = ctypes.CDLL(str(library))
    loaded.frame_encode.argtypes = [ctypes.c_char_p, ctypes.c_uint16, ctypes.c_uint32, ctypes.c_uint16]
    loaded.frame_encode.restype = None
    loaded.passage_step.argtypes = [
        ctypes.POINTER(CPassage),
        ctypes.POINTER(CGate),
        ctypes.c_uint32,
        ctypes.c_uint16,
    ]
    loaded.passage_step.restype = ctypes.c_uint32
    return loaded


def framed(code: ctypes.CDLL, sequence: int, device_us: int, counts: int) -> bytes:
    frame = ctypes.create_string_buffer(FRAME_BYTES[1])
    code.frame_encode(frame, sequence, device_us, counts)
    return frame.raw


def passages(code: ctypes.CDLL, us: list[int], counts: list[int]) -> list[tuple[int, int]]:
    """Sample and duration, us, of every passage."""
    passage, gate = CPassage(), CGate(TOP, BOTTOM)
    took = [
        (i, code.passage_step(ctypes.byref(passage), ctypes.byref(gate), t % WRAP_US, reading))
        for i, (t, reading) in enumerate(zip(us, counts, strict=True))
    ]
    return [(i, duration) for i, duration in took if duration]


def naive_passages(us: list[int], counts: list[int]) -> list[tuple[int, Fraction]]:
    """The same, by looking back from every crossing of the bottom for one of the top that no other has used."""

    def crossings(level: int) -> dict[int, Fraction]:
        return {
            i: us[i] - Fraction((level - counts[i]) * (us[i] - us[i - 1]), counts[i - 1] - counts[i])
            for i in range(1, len(us))
            if counts[i - 1] > level >= counts[i]
        }

    tops, bottoms = crossings(TOP), crossings(BOTTOM)
    found = []
    for before, i in pairwise([-1, *bottoms]):
        since = [top for top in tops if before < top <= i]
        if since:
            found.append((i, bottoms[i] - tops[since[-1]]))
    return found


@given(st.integers(0, 65535), st.integers(0, WRAP_US - 1), st.integers(0, 65535))
def test_a_frame_is_the_readers(code: ctypes.CDLL, sequence: int, device_us: int, counts: int) -> None:
    assert framed(code, sequence, device_us, counts) == encode(sequence, device_us, counts)


@given(st.lists(st.sampled_from([0, 1, 255, 256, 65280, 65535]), min_size=4, max_size=4))
def test_a_frame_with_zeros_is_the_readers(code: ctypes.CDLL, words: list[int]) -> None:
    sequence, low, high, counts = words
    assert framed(code, sequence, low | high << 16, counts) == encode(sequence, low | high << 16, counts)


def test_frames_of_every_sequence_number(code: ctypes.CDLL) -> None:
    # 65536 numbers meet every value of the CRC's bytes, zeros among them.
    for sequence in range(65536):
        assert framed(code, sequence, 200 * sequence, 512) == encode(sequence, 200 * sequence, 512)


@given(
    st.lists(st.integers(0, 1023) | st.integers(160, 168) | st.integers(243, 249), min_size=1, max_size=60),
    st.sampled_from([200, 1000]),
    st.integers(0, WRAP_US - 1),
)
def test_passages_are_those_of_exact_arithmetic(
    code: ctypes.CDLL, counts: list[int], period_us: int, start_us: int
) -> None:
    us = [start_us + period_us * i for i in range(len(counts))]
    got = passages(code, us, counts)
    wanted = naive_passages(us, counts)
    assert {i for i, _ in got} <= {i for i, _ in wanted}
    # Each of two crossings is rounded up to a whole microsecond; what comes to none is no passage.
    durations = dict(got)
    assert all(abs(durations.get(i, 0) - duration) < 1 for i, duration in wanted)


@pytest.mark.parametrize("speed_mm_s", [60.0, 200.0, 400.0])
@pytest.mark.parametrize("seed", range(5))
def test_a_passage_is_the_one_that_palpate_times(code: ctypes.CDLL, speed_mm_s: float, seed: int) -> None:
    foot = trajectory(np.random.default_rng(seed), speed_mm_s, hesitation="none")
    us = np.arange(0, foot.duration_us, 1000).astype(np.int64)
    # 8.2 counts/mm, so that the gate's levels are whole counts.
    counts = np.rint(82 + 8.2 * foot.at(us.astype(np.float64))).astype(np.int64)
    ((_, duration_us),) = passages(code, us.tolist(), counts.tolist())
    detector = GateDetector(Step(gate_top_mm=20.0, gate_bottom_mm=10.0, contact_mm=0.0))
    samples = Samples(us, (counts - 82) / 8.2, b"", np.zeros(us.size, dtype=np.int64), 0)
    _, events = detector.step(detector.init(), samples)
    (gate,) = (event for event in events if isinstance(event, Gate))
    assert duration_us == pytest.approx(gate.bottom_us - gate.top_us, abs=1.001)


def test_a_step_begun_inside_the_gate_is_none(code: ctypes.CDLL) -> None:
    counts = [200, 180, 100, 82, 240, 100, 82]
    assert passages(code, [1000 * i for i in range(len(counts))], counts) == []
