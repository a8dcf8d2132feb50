"""What is made of a measurement of the audio device: a good one is taken, a disturbed one made again, then refused."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import pytest

from palpate.experiment.apparatus import rig
from palpate.experiment.apparatus.audio import calibration
from palpate.experiment.apparatus.audio.calibration import Loopback
from palpate.experiment.errors import AudioError
from palpate.experiment.protocol.files import shipped

AUDIO = rig.load(shipped("rigs/headless.toml")).audio
assert AUDIO is not None
assert (AUDIO.delivered.onset_ms, AUDIO.delivered.gain_db, AUDIO.delivered.residual_db) == (2.0, 1.0, -20.0)
GOOD = Loopback(
    round_trip_frames=256.0,
    spread_frames=96,
    gain=1.0,
    spread_db=1.0,
    residual_db=-20.0,
    probes=20,
    xruns=0,
    output_ms=2.667,
    input_ms=2.667,
    as_reported=True,
)
"""At the limits: 96 frames at 48 kHz are 2 ms."""

DISTURBED = {
    "xruns": (replace(GOOD, xruns=7), "got 7 xruns in 20 probes (allowed: none); close"),
    "latency": (replace(GOOD, spread_frames=97), "latencies that vary by 2.02 ms in 20 probes (allowed: 2 ms"),
    "level": (replace(GOOD, spread_db=1.01), "levels that vary by 1.01 dB in 20 probes (allowed: 1 dB"),
    "residual": (replace(GOOD, residual_db=-3.0), "a residual of -3 dB in 20 probes (allowed: -20 dB"),
}


@pytest.mark.parametrize("what", DISTURBED)
def test_a_measurement_that_was_disturbed_is_made_again(what: str) -> None:
    disturbed, _ = DISTURBED[what]
    measured = deque([disturbed, disturbed, GOOD])
    assert AUDIO is not None
    assert calibration.steadily(measured.popleft, AUDIO, exact=False) == GOOD
    assert not measured


@pytest.mark.parametrize("what", DISTURBED)
def test_one_that_is_disturbed_each_time_is_refused(what: str) -> None:
    disturbed, said = DISTURBED[what]
    measured = deque([disturbed] * 3)
    assert AUDIO is not None
    with pytest.raises(AudioError) as refused:
        calibration.steadily(measured.popleft, AUDIO, exact=False)
    assert said in str(refused.value)
    assert not measured


def test_xruns_of_a_server_that_waits_disturb_nothing() -> None:
    assert AUDIO is not None
    found, _ = DISTURBED["xruns"]
    assert calibration.steadily(lambda: found, AUDIO, exact=True) == found


def test_a_calibrated_table_no_longer_says_that_it_is_not() -> None:
    before = shipped("rigs/laboratory.toml").read_text("utf-8")
    after = calibration.rewritten(before, {"output_ms": "3.5"})
    assert "palpate calibrate audio` measures it" in before
    stale = "[audio.latency]         # NOT CALIBRATED: `palpate calibrate audio` measures it\noutput_ms = 0.0\n"
    assert after == before.replace(stale, "[audio.latency]\noutput_ms = 3.5\n")
