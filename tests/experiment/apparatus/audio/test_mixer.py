"""The mixer without a device: blocks of any size against a sum written down frame by frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from palpate.experiment.apparatus.audio import mixer as mixing
from palpate.experiment.apparatus.audio.mixer import AT_ONCE, SLOTS, SOMETIME, Cue, Layout, Loop, Mixer
from palpate.experiment.errors import AudioError
from tests.approved import Refuses
from tests.experiment.apparatus.audio import interleaved

MODULES = (mixing,)
"""What callback and session run of their own."""

ANYTHING = st.floats(allow_nan=True, allow_infinity=True, width=32)


def mixer(*, ceilings: tuple[float, ...] = (1.0, 1.0), block: int = 400, kept: int = 4096) -> Mixer:
    return Mixer(Layout(len(ceilings), 1, block, 1000, kept, ceilings))


def run(mixed: Mixer, blocks: list[int]) -> np.ndarray:
    """What leaves the outputs; the input hears the number of each frame."""
    made = []
    for frames in blocks:
        outputs = np.full((frames, mixed.layout.outputs), 9.0, np.float32)
        mixed.fill(outputs, (mixed.frame + np.arange(frames, dtype=np.float32))[:, None])
        made.append(outputs)
    return np.concatenate(made)


@dataclass(frozen=True)
class Asked:
    """A stimulus: where it is first asked for, where it is moved to before the stream begins, and its samples."""

    frame: int
    moved: int | None
    channel: int
    samples: np.ndarray


ASKED = st.builds(
    Asked,
    frame=st.integers(0, 300),
    moved=st.none() | st.integers(0, 300),
    channel=st.integers(0, 1),
    samples=arrays.arrays(np.float32, st.integers(1, 150), elements=ANYTHING),
)


@settings(max_examples=200)
@given(
    stimuli=st.lists(ASKED, max_size=SLOTS),
    blocks=st.lists(st.integers(1, 400), min_size=1, max_size=20),
    ceilings=st.tuples(st.floats(0, 1, width=32), st.floats(0, 1, width=32)),
)
def test_every_stimulus_is_summed_at_its_frame_and_limited_last(
    stimuli: list[Asked], blocks: list[int], ceilings: tuple[float, float]
) -> None:
    mixed = mixer(ceilings=ceilings)
    wanted = np.zeros((sum(blocks) + 500, 2), np.float32)
    cues = []
    for one in stimuli:
        cues.append(mixed.schedule(one.samples, channel=one.channel, frame=one.frame))
        begin = one.frame
        if one.moved is not None:
            assert mixed.move(cues[-1], one.moved)
            begin = one.moved
        with np.errstate(all="ignore"):
            wanted[begin : begin + len(one.samples), one.channel] += one.samples
    made = run(mixed, blocks)
    wanted = wanted[: len(made)]
    expected = np.clip(np.where(np.isnan(wanted), 0, wanted), [-c for c in ceilings], ceilings).astype(np.float32)
    # Sums of several stimuli depend on their order in the last bit.
    np.testing.assert_allclose(made, expected, rtol=1e-6, atol=1e-6)
    assert np.all(np.abs(made) <= np.array(ceilings, np.float32))
    for one, cue in zip(stimuli, cues, strict=True):
        begin = one.frame if one.moved is None else one.moved
        assert cue.started == (begin if begin < len(made) else None)
        assert cue.done == (begin + len(one.samples) <= len(made))


@settings(max_examples=100)
@given(
    blocks=st.lists(st.integers(1, 400), min_size=1, max_size=30),
    length=st.integers(1, 200),
    gains=st.lists(st.floats(0, 1, width=32), min_size=1, max_size=3),
    step=st.floats(1e-3, 1.0),
)
def test_a_loop_goes_on_and_its_gain_never_jumps(
    blocks: list[int], length: int, gains: list[float], step: float
) -> None:
    mixed = mixer()
    loop = mixed.loop = Loop(step, samples=np.ones(length, np.float32), channels=(0,))
    made = []
    for gain in gains:
        loop.wanted = gain
        made.append(run(mixed, blocks)[:, 0])
    steps = np.diff(np.concatenate([[0.0], *made]))
    assert np.max(np.abs(steps), initial=0) <= step * (1 + 1e-4) + 1e-6
    before = 0.0
    for gain, one in zip(gains, made, strict=True):
        if (len(one) - 1) * step > abs(gain - before) + 1e-3:
            assert one[-1] == np.float32(gain)
        before = float(one[-1])


def test_a_loop_plays_the_frame_modulo_its_length() -> None:
    mixed = mixer()
    samples = np.linspace(-1, 1, 97, dtype=np.float32)
    loop = mixed.loop = Loop(1.0, samples=samples, channels=(1,))
    loop.wanted = loop.gain = 0.5
    made = run(mixed, [64, 1, 63, 50, 64, 64])
    assert np.array_equal(made[:, 1], 0.5 * samples[np.arange(len(made)) % 97])
    assert not made[:, 0].any()


def test_what_comes_too_late_is_not_played_and_says_so() -> None:
    mixed = mixer()
    run(mixed, [64])
    cue = mixed.schedule(np.ones(10), channel=0, frame=63)
    assert not run(mixed, [64, 64]).any()
    assert (cue.late, cue.done, cue.started) == (True, True, None)
    assert not mixed.move(cue, 400)
    assert mixed.withdraw(cue)


def test_at_once_is_the_next_block_and_what_has_started_stays() -> None:
    mixed = mixer()
    run(mixed, [64])
    cue = mixed.schedule(np.ones(100), channel=0, frame=AT_ONCE)
    made = run(mixed, [64])
    assert cue.started == 64
    assert made[:, 0].all()
    assert not mixed.move(cue, 400)
    assert not mixed.withdraw(cue)
    assert np.count_nonzero(run(mixed, [64])) == 36
    assert cue.done
    assert not mixed.withdraw(cue)


def test_what_sounds_where_nothing_is_allowed_to_ends_with_the_block_before() -> None:
    allowed = [True, True, False, True]
    mixed = mixer()
    mixed.allowed = lambda: allowed.pop(0)
    cut = mixed.schedule(np.full(1000, 0.5), channel=0, frame=0)
    later = mixed.schedule(np.full(100, 0.25), channel=0, frame=300)
    left = run(mixed, [100] * 4)[:, 0]
    assert left.tolist() == [0.5] * 200 + [0.0] * 100 + [0.25] * 100
    assert (cut.cut, cut.done, cut.started) == (True, True, 0)
    assert (later.cut, later.started) == (False, 300)


FADE = 96
"""Frames of the fade of `ending`."""


def ending() -> tuple[Mixer, Loop]:
    """A mixer whose loop plays 0.25 on the second output, and stays there for a while."""
    mixed = Mixer(Layout(2, 1, 400, 1000, 4096, (1.0, 1.0), step=1 / FADE))
    loop = mixed.loop = Loop(1 / FADE, samples=np.ones(7, np.float32), channels=(1,))
    loop.wanted = loop.gain = 0.25
    return mixed, loop


@settings(max_examples=200)
@given(
    ends=st.integers(0, 1000),
    frame=st.just(AT_ONCE) | st.integers(0, 1200),
    length=st.integers(1, 1000),
    blocks=st.lists(st.integers(1, 400), min_size=1, max_size=20),
)
def test_at_the_end_whatever_sounds_fades_and_nothing_begins(
    ends: int, frame: int, length: int, blocks: list[int]
) -> None:
    mixed, _ = ending()
    mixed.whole.ends = ends
    cue = mixed.schedule(np.ones(length), channel=0, frame=frame)
    made = run(mixed, [*blocks, 400, 400, 400, 400])
    begins = max(frame, 0)
    plays = begins < ends
    expected = np.zeros((len(made), 2))
    expected[:, 1] = 0.25
    if plays:
        expected[begins : begins + length, 0] = 1.0
    expected *= np.clip(1 - (np.arange(len(made)) - ends + 1) / FADE, 0, 1)[:, None]
    assert np.allclose(made, expected, rtol=0, atol=1e-5)
    assert not made[ends + FADE :].any()
    assert (cue.started, cue.cut) == ((begins, begins + length > ends) if plays else (None, True))
    assert cue.done
    assert mixed.withdraw(cue) == (not plays)


@pytest.mark.parametrize("block", [1, 50, 64, 400])
def test_an_end_in_the_past_fades_from_the_next_block_without_a_step(block: int) -> None:
    mixed, _ = ending()
    sounding = mixed.schedule(np.ones(1000), channel=0, frame=0)
    waiting = mixed.schedule(np.ones(10), channel=0, frame=SOMETIME)
    before = run(mixed, [400])
    mixed.whole.ends = 17
    after = run(mixed, [block] * (400 // block))
    assert before[-1].tolist() == [1.0, 0.25]
    steps = np.diff(np.concatenate([before, after]), axis=0)
    assert np.max(np.abs(steps[399:])) <= 1.01 / FADE
    assert not after[FADE:].any()
    assert not run(mixed, [1]).any()
    assert (sounding.cut, sounding.done, waiting.done) == (True, True, False)
    assert mixed.move(waiting, AT_ONCE)
    assert not run(mixed, [64]).any()
    assert (waiting.cut, waiting.done, waiting.started) == (True, True, None)


def test_the_end_of_a_loop_leaves_stimuli_and_may_be_put_off() -> None:
    mixed, loop = ending()
    loop.ends = 100
    mixed.schedule(np.full(1000, 0.5), channel=0, frame=0)
    made = run(mixed, [64] * 8)
    assert np.all(made[:, 0] == 0.5)
    fading = np.clip(0.25 - (np.arange(512) - 99) / FADE, 0, 0.25)
    assert np.allclose(made[:, 1], fading, rtol=0, atol=1e-5)
    assert not made[100 + FADE // 4 :, 1].any()
    loop.ends = SOMETIME
    again = run(mixed, [400])
    assert np.allclose(again[:, 1], np.clip(np.arange(1, 401) / FADE, 0, 0.25), rtol=0, atol=1e-5)


def test_a_device_that_stood_still_plays_nothing_that_waited_for_its_frame() -> None:
    mixed, _ = ending()
    sounding = mixed.schedule(np.ones(1000), channel=0, frame=0)
    waiting = [mixed.schedule(np.ones(9), channel=0, frame=frame) for frame in (AT_ONCE, 120, 5000)]
    to_be_aimed = mixed.schedule(np.ones(9), channel=0, frame=SOMETIME)
    assert mixed.withdraw(waiting.pop(0))
    run(mixed, [100])
    waiting.append(mixed.schedule(np.ones(9), channel=0, frame=AT_ONCE))
    mixed.stood_still = True
    again = run(mixed, [64])
    mixed.stood_still = False
    assert not again[:, 0].any()
    assert np.allclose(again[:, 1], 0.25 * np.arange(1, 65) / FADE, rtol=0, atol=1e-5)
    assert (sounding.cut, sounding.done) == (True, True)
    assert [(one.late, one.done, one.started) for one in waiting] == [(True, True, None)] * 3
    assert mixed.move(to_be_aimed, AT_ONCE)
    assert np.count_nonzero(run(mixed, [64])[:, 0]) == 9


def test_what_was_over_while_the_device_stood_still_is_not_heard_again() -> None:
    mixed, _ = ending()
    mixed.whole.ends = 500
    assert run(mixed, [400])[-1, 1] == 0.25
    mixed.whole.ends, mixed.stood_still = 350, True
    assert not run(mixed, [400]).any()


def test_a_withdrawn_stimulus_leaves_its_place_to_another(refuses: Refuses) -> None:
    mixed = mixer()
    cues = [mixed.schedule(np.ones(4), channel=0, frame=1000) for _ in range(SLOTS)]
    with refuses(AudioError):
        mixed.schedule(np.ones(4), channel=0, frame=0)
    assert mixed.withdraw(cues[3])
    later = mixed.schedule(np.full(4, 0.5), channel=1, frame=0)
    # The cue of the stimulus that had the place before no longer moves anything.
    assert not mixed.move(cues[3], 2)
    assert mixed.withdraw(cues[3])
    assert np.count_nonzero(run(mixed, [8])[:, 1]) == 4
    assert later.done


def told_truly(mixed: Mixer, cue: Cue, withdrawn: bool, before: np.ndarray) -> None:
    """What `withdraw` said is what is heard from then on, and whose place it was is free again."""
    after = run(mixed, [64] * 8)
    assert before.any() == (not withdrawn) == (cue.started is not None)
    assert before.any() or not after.any(), "what had not begun to sound sounds after it was withdrawn"
    assert mixed.withdraw(cue) == withdrawn
    assert cue.done
    later = [mixed.schedule(np.ones(4), channel=0, frame=AT_ONCE) for _ in range(SLOTS)]
    run(mixed, [64])
    assert all(each.started is not None for each in later)


def make(mixed: Mixer, made: list[np.ndarray]) -> None:
    made.append(run(mixed, [64]))


def withdraw(mixed: Mixer, cue: Cue, said: list[bool]) -> None:
    said.append(mixed.withdraw(cue))


@pytest.mark.parametrize("frame", [10, 200, AT_ONCE])
@pytest.mark.parametrize("moved", [None, 20, 150])
def test_what_is_withdrawn_at_any_point_of_a_block_never_sounds_later(frame: int, moved: int | None) -> None:
    still = mixer()
    still.schedule(np.ones(30), channel=0, frame=frame)
    opcodes = interleaved.points(MODULES, lambda: run(still, [64]), lambda _: None)
    # The session may move it at one point and withdraw it at a later one, while the callback has it in hand.
    for point in range(opcodes):
        for apart in (0,) if moved is None else (0, 5, 20):
            mixed = mixer()
            said: list[bool] = []
            made: list[np.ndarray] = []
            cue = mixed.schedule(np.ones(30), channel=0, frame=frame)

            def meanwhile(
                at: int,
                mixed: Mixer = mixed,
                cue: Cue = cue,
                said: list[bool] = said,
                when: tuple[int, int] = (point, point + apart),
            ) -> None:
                if at == when[0] and moved is not None:
                    mixed.move(cue, moved)
                if at == when[1]:
                    said.append(mixed.withdraw(cue))

            interleaved.points(MODULES, partial(make, mixed, made), meanwhile)
            told_truly(mixed, cue, said[0] if said else mixed.withdraw(cue), made[0])


@pytest.mark.parametrize("frame", [10, 100, AT_ONCE])
def test_a_block_that_is_made_while_something_is_withdrawn_does_as_withdraw_says(frame: int) -> None:
    still = mixer()
    gone = still.schedule(np.ones(30), channel=0, frame=frame)
    for point in range(interleaved.points(MODULES, lambda: still.withdraw(gone), lambda _: None)):
        mixed = mixer()
        said: list[bool] = []
        made: list[np.ndarray] = []
        cue = mixed.schedule(np.ones(30), channel=0, frame=frame)

        def meanwhile(at: int, mixed: Mixer = mixed, made: list[np.ndarray] = made, point: int = point) -> None:
            if at == point:
                made.append(run(mixed, [64, 64]))

        interleaved.points(MODULES, partial(withdraw, mixed, cue, said), meanwhile)
        told_truly(mixed, cue, said[0], made[0])


@given(blocks=st.lists(st.integers(1, 64), min_size=3, max_size=60), data=st.data())
def test_input_is_kept_by_its_frame(blocks: list[int], data: st.DataObject) -> None:
    mixed = mixer(kept=300, block=64)
    run(mixed, blocks)
    end = sum(blocks)
    oldest = max(end + 64 - 300, 0)
    first = data.draw(st.integers(oldest, end)) if oldest <= end else end
    frames = data.draw(st.integers(0, end - first))
    assert mixed.recorded_inputs(first, frames)[:, 0].tolist() == list(range(first, first + frames))
    with pytest.raises(AudioError, match="up to frame"):
        mixed.recorded_inputs(end, 1)
    if oldest > 0:
        with pytest.raises(AudioError, match="request it sooner"):
            mixed.recorded_inputs(oldest - 1, 1)


@pytest.mark.parametrize("ceilings", [(1.1, 1.0), (-0.1, 1.0), (float("nan"), 1.0)])
def test_what_is_no_ceiling_is_refused(ceilings: tuple[float, float], refuses: Refuses) -> None:
    with refuses(AudioError):
        mixer(ceilings=ceilings)


@pytest.mark.parametrize("waveform", [np.ones(0), np.ones(1001), np.ones((2, 2)), np.float64(1)])
def test_what_is_no_stimulus_is_refused(waveform: np.ndarray, refuses: Refuses) -> None:
    with refuses(AudioError):
        mixer().schedule(waveform, channel=0, frame=0)


@pytest.mark.parametrize("channel", [-1, 2])
def test_a_missing_channel_is_refused(channel: int) -> None:
    with pytest.raises(AudioError, match=f"got output channel {channel + 1}; allowed: 1 to 2"):
        mixer().schedule(np.ones(1), channel=channel, frame=0)
