"""The audio stream on a JACK server of our own: what is played is heard, at its frame, sample for sample."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest

from palpate.experiment.apparatus.audio.mixer import AT_ONCE, Cue, Mixer
from palpate.experiment.apparatus.audio.stream import AudioStream
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.errors import AudioError
from palpate.experiment.rehearsal.wires.sound_card import SoundCard
from tests.approved import Refuses
from tests.rig import sound

pytestmark = pytest.mark.alone


@pytest.fixture(scope="module")
def card() -> Iterator[SoundCard]:
    with sound.sound_card() as opened:
        yield opened


@pytest.fixture
def looped(card: SoundCard) -> Iterator[AudioStream]:
    """Output 1 is cabled to input 1, output 3 to input 2; only half of full scale may pass output 3."""
    with sound.stream(ceilings=(1.0, 1.0, 0.5, 1.0)) as opened:
        card.disconnect(1)
        card.disconnect(2)
        card.connect(1, 1)
        card.connect(3, 2)
        yield opened


def round_trip(stream: AudioStream) -> int:
    """Frames from an output to the input that it is cabled to."""
    cue = stream.schedule(np.ones(1, np.float32), channel=0, frame=stream.next_frame + 4 * sound.BLOCK)
    heard = stream.recorded_inputs(cue.frame, 8 * sound.BLOCK)[:, 0]
    [at] = np.flatnonzero(heard)
    return int(at)


def test_every_start_is_at_its_frame_and_every_sample_is_heard(looped: AudioStream) -> None:
    rng = np.random.default_rng(1)
    behind = round_trip(looped)
    errors, missed, wrong = [], 0, 0
    for number in range(200):
        wanted = rng.uniform(-1, 1, int(rng.integers(1, 300))).astype(np.float32)
        wanted[[0, -1]] = 0.5
        frame = looped.next_frame + looped.lead_frames + int(rng.integers(1, 2 * sound.BLOCK))
        cue = looped.schedule(wanted, channel=0, frame=frame)
        if number % 2:
            frame += int(rng.integers(1, sound.BLOCK))
            assert looped.move(cue, frame)
        # From the end of whatever was heard before to well after its own end.
        heard = looped.recorded_inputs(frame + behind - 50, 400)[:, 0]
        sounding = np.flatnonzero(heard)
        missed += cue.started is None
        errors.append(int(sounding[0]) - 50)
        wrong += not np.array_equal(heard[50 : 50 + wanted.size], wanted)
    assert (missed, wrong, set(errors)) == (0, 0, {0})


def test_a_start_in_the_past_is_reported_and_never_played(looped: AudioStream) -> None:
    begun = looped.next_frame
    cue = looped.schedule(np.ones(64), channel=0, frame=begun - 1)
    looped.wait(begun + 4 * sound.BLOCK)
    assert (cue.late, cue.done, cue.started) == (True, True, None)
    assert looped.withdraw(cue)
    assert not looped.recorded_inputs(begun, 4 * sound.BLOCK)[:, 0].any()


def test_a_callback_that_came_too_late_makes_misses_that_are_counted(
    looped: AudioStream, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The machine is slow: a callback finds that the frames it was to make have passed meanwhile.
    fill, skipped = Mixer.fill, 40 * sound.BLOCK

    def slow(mixer: Mixer, outputs: np.ndarray, inputs: np.ndarray) -> None:
        if mixer.frame >= begun and not went:
            went.append(mixer.frame)
            mixer.frame += skipped
        fill(mixer, outputs, inputs)

    went: list[int] = []
    begun = looped.next_frame + 20 * sound.BLOCK
    cues = [looped.schedule(np.ones(8), channel=0, frame=begun + n * 10 * sound.BLOCK) for n in range(-1, 7)]
    monkeypatch.setattr(Mixer, "fill", slow)
    looped.wait(begun + 80 * sound.BLOCK)
    assert [cue.late for cue in cues] == [went[0] <= cue.frame < went[0] + skipped for cue in cues]
    assert sum(cue.late for cue in cues) == 4
    assert all((cue.started is None) == cue.late for cue in cues)


def test_a_server_that_stands_still_is_a_gap_and_at_length_an_error(
    card: SoundCard, looped: AudioStream, monkeypatch: pytest.MonkeyPatch, refuses: Refuses
) -> None:
    gaps = looped.health.gaps
    with sound.halted(card):
        MonotonicClock().sleep_ns(100 * 10**6)
    looped.wait(looped.next_frame + 40 * sound.BLOCK)
    assert looped.health.gaps > gaps
    monkeypatch.setattr("palpate.experiment.apparatus.audio.stream.SILENT_S", 0.3)
    with (
        sound.halted(card),
        refuses(AudioError),
    ):
        looped.wait(looped.next_frame + sound.RATE_HZ)


def test_at_once_is_with_the_next_block(looped: AudioStream) -> None:
    before = looped.next_frame
    cue = looped.schedule(np.ones(64), channel=0, frame=AT_ONCE)
    looped.wait(before + 3 * sound.BLOCK)
    assert cue.started is not None
    assert before <= cue.started <= before + 2 * sound.BLOCK


def test_what_was_withdrawn_is_not_heard_and_what_sounds_cannot_be(looped: AudioStream) -> None:
    begun = looped.next_frame
    cue = looped.schedule(np.ones(64), channel=0, frame=begun + 8 * sound.BLOCK)
    assert looped.withdraw(cue)
    assert not looped.move(cue, begun + 9 * sound.BLOCK)
    assert not looped.recorded_inputs(begun, 12 * sound.BLOCK)[:, 0].any()
    sounding = looped.schedule(np.ones(sound.RATE_HZ), channel=0, frame=AT_ONCE)
    looped.wait(looped.next_frame + 3 * sound.BLOCK)
    assert not looped.withdraw(sounding)
    assert not looped.move(sounding, looped.next_frame + 9 * sound.BLOCK)


def test_nothing_above_the_ceiling_leaves_whatever_was_asked_for(looped: AudioStream) -> None:
    wanted = np.array([np.nan, np.inf, -np.inf, 0.75, -0.75, 0.5, 0.25, 1e-40])
    behind = round_trip(looped)
    limited = [looped.limited(channel) for channel in range(4)]
    cue = looped.schedule(wanted, channel=2, frame=looped.next_frame + 4 * sound.BLOCK)
    heard = looped.recorded_inputs(cue.frame + behind, wanted.size)[:, 1]
    assert heard.tolist() == np.array([0, 0.5, -0.5, 0.5, -0.5, 0.5, 0.25, 1e-40], np.float32).tolist()
    assert [looped.limited(channel) for channel in range(4)] == [*limited[:2], limited[2] + 5, limited[3]]


def test_stimuli_and_loop_are_mixed_on_one_clock(looped: AudioStream) -> None:
    rng = np.random.default_rng(2)
    behind = round_trip(looped)
    masker = rng.uniform(-0.25, 0.25, 1000).astype(np.float32)
    loop = looped.play_loop(masker, (0,))
    loop.wanted = 0.5
    looped.wait(looped.next_frame + round(0.1 * sound.RATE_HZ))
    assert loop.gain == 0.5
    stimulus = rng.uniform(-0.25, 0.25, 300).astype(np.float32)
    cues: list[Cue] = [
        looped.schedule(stimulus, channel=0, frame=looped.next_frame + 4 * sound.BLOCK + shift) for shift in (0, 100)
    ]
    first = cues[0].frame
    heard = looped.recorded_inputs(first + behind - 50, 1500)[:, 0]
    expected = 0.5 * masker[np.arange(first - 50, first + 1450) % 1000]
    for shift in (50, 150):
        expected[shift : shift + 300] += stimulus
    assert np.allclose(heard, expected, rtol=0, atol=2**-24)


LOSES_ITS_SERVER = """
from tests.rig import sound
with sound.sound_card() as card, sound.stream() as stream:
    stream.wait(stream.next_frame + 1)
    card.server.kill()
    card.server.wait()
print("closed")
"""


@pytest.mark.usefixtures("card")
def test_a_process_whose_server_has_gone_closes_and_ends() -> None:
    ended = subprocess.run(
        [sys.executable, "-c", LOSES_ITS_SERVER], capture_output=True, text=True, timeout=60, check=False
    )
    assert (ended.returncode, ended.stdout) == (0, "closed\n"), ended.stderr
