"""The actuator on a channel of the audio stream: aimed, heard by loopback, missed and withdrawn."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from datetime import date, timedelta

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus import opening as opening_audio
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.audio.actuator import TAKEN_BACK, AudioActuator
from palpate.experiment.apparatus.audio.mixer import AT_ONCE, Cue
from palpate.experiment.apparatus.audio.stream import AudioStream
from palpate.experiment.apparatus.panel.conditioning import Conditioner
from palpate.experiment.apparatus.panel.inverse import Inverse
from palpate.experiment.apparatus.panel.movement import Movement, Reference
from palpate.experiment.apparatus.ports import Actuator
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.errors import ActuatorError, RigError
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.wires.panel import CardPanel
from palpate.experiment.rehearsal.wires.sound_card import DEVICE, SoundCard
from tests.approved import Refuses
from tests.experiment.apparatus.panel.test_movement import stated
from tests.experiment.synthesis.stimuli import given
from tests.rig import sound

pytestmark = pytest.mark.alone

CLOCK = MonotonicClock()
MS = 10**6
DAY = date(2026, 11, 22)


def headless(**changed: object) -> Rig:
    """The shipped rig, with an actuator that takes accelerations."""
    rig = rigs.load(shipped("rigs/headless.toml"))
    assert rig.audio is not None
    actuator = rig.actuator.model_copy(update={"shaping": None, "full_scale_m_s2": 64.0})
    return rig.model_copy(update={"actuator": actuator, "audio": rig.audio.model_copy(update=changed)})


RIG = headless()
assert RIG.audio is not None
OUTPUT_MS = RIG.audio.latency.output_ms


def stimulus(seed: int = 0, samples: int = 4800) -> np.ndarray:
    wave = np.random.default_rng(seed).uniform(-15, 15, samples)
    wave[[0, -1]] = 1.0
    return wave


@pytest.fixture(scope="module")
def card() -> Iterator[SoundCard]:
    assert RIG.audio is not None
    with sound.sound_card(block=RIG.audio.block, outputs=3) as opened:
        yield opened


@pytest.fixture
def stream(card: SoundCard) -> Iterator[AudioStream]:
    opened = opening_audio.open_audio(
        RIG, limits_m_s2={None: 20.0}, listens=False, masker=None, clock=CLOCK, today=DAY, device=DEVICE
    )
    for entry in (1, 2):
        card.disconnect(entry)
    card.connect(3, 2)
    yield opened
    opened.close()


@pytest.fixture
def actuator(stream: AudioStream) -> Actuator:
    return opening.open_actuator(RIG, limit_m_s2=20.0, stream=stream)


@pytest.fixture
def panel(card: SoundCard, stream: AudioStream) -> Iterator[CardPanel]:
    opened = CardPanel(card.tap(3, seconds=5.0), RIG.actuator)
    yield opened
    opened.close()


def test_a_stimulus_is_heard_and_felt_as_it_was_intended(actuator: Actuator, panel: CardPanel) -> None:
    for seed in range(5):
        wanted = stimulus(seed)
        played = actuator.prepare(given(wanted))
        assert (played.samples.size, played.limited) == (4800, 0)
        onset_ns = CLOCK.now_ns() + 80 * MS
        assert actuator.aim(onset_ns)
        assert actuator.aim(onset_ns - 20 * MS)
        actuator.landed(onset_ns - 20 * MS)
        heard = actuator.delivered(onset_ns - 20 * MS)
        assert heard is not None
        assert heard.requested_ns == onset_ns - 20 * MS
        assert (heard.gain, heard.residual_db) == (1.0, -200.0)
        # How far session time and the stream's went apart meanwhile is the machine's affair, and on the record.
        assert heard.onset_ns is not None
        assert heard.onset_error_ms is not None
        assert heard.onset_error_ms == pytest.approx((heard.onset_ns - heard.requested_ns) / MS)
        assert heard.delivered == (abs(heard.onset_error_ms) <= 2.0), heard.reason
        felt = panel.felt(1.0)
        assert felt is not None
        assert np.array_equal(felt, (wanted / 64).astype(np.float32).astype(np.float64) * 64)
        assert panel.felt(0) is None


@pytest.mark.parametrize("loopback", [2, None], ids=["heard", "without a loopback"])
def test_what_the_stream_limits_is_not_delivered(stream: AudioStream, loopback: int | None) -> None:
    assert RIG.audio is not None
    rig = headless(channels=RIG.audio.channels.model_copy(update={"loopback": loopback}))
    # The stream was opened for a study that allows 20 m/s^2.
    actuator = opening.open_actuator(rig, limit_m_s2=60.0, stream=stream)
    wanted = stimulus()
    wanted[100:107] = (21, -21, 30, -30, 60, -60, 20)
    heard = []
    for wave in (wanted, np.clip(wanted, -20, 20)):
        actuator.prepare(given(wave))
        onset_ns = CLOCK.now_ns() + 80 * MS
        assert actuator.aim(onset_ns)
        heard.append(actuator.delivered(onset_ns))
    assert heard[0] is not None
    assert not heard[0].delivered
    assert "(6 samples " in heard[0].reason
    assert heard[1] is None if loopback is None else heard[1] is not None and heard[1].gain == 1.0


def test_what_lies_within_the_lead_is_refused_and_nothing_changes(actuator: Actuator, stream: AudioStream) -> None:
    actuator.prepare(given(stimulus()))
    within = stream.next_frame + stream.lead_frames - 2
    assert not actuator.aim(stream.ns_of(within) + round(OUTPUT_MS * MS))
    later_ns = CLOCK.now_ns() + 200 * MS
    assert actuator.aim(later_ns)
    assert not actuator.aim(CLOCK.now_ns() - 50 * MS)
    heard = actuator.delivered(later_ns)
    assert heard is not None
    assert heard.requested_ns == later_ns
    assert heard.onset_ns is not None
    assert not actuator.aim(CLOCK.now_ns() + 200 * MS)


def test_a_stimulus_that_was_never_aimed_sounds_once_the_foot_has_landed(actuator: Actuator) -> None:
    actuator.prepare(given(stimulus()))
    contact_ns = CLOCK.now_ns()
    actuator.landed(contact_ns)
    heard = actuator.delivered(contact_ns)
    assert heard is not None
    assert heard.requested_ns == contact_ns
    assert heard.gain == 1.0
    assert heard.onset_error_ms is not None
    assert heard.onset_error_ms > 0


@pytest.mark.parametrize("late_ms", [30, -30])
def test_what_sounds_as_asked_but_not_at_contact_is_not_delivered(stream: AudioStream, late_ms: int) -> None:
    """However far the stream's time and the session's went apart meanwhile."""
    assert RIG.audio is not None
    lenient = headless(delivered=RIG.audio.delivered.model_copy(update={"onset_ms": 100.0}))
    actuator = opening.open_actuator(lenient, limit_m_s2=20.0, stream=stream)
    actuator.prepare(given(stimulus()))
    onset_ns = CLOCK.now_ns() + 80 * MS
    assert actuator.aim(onset_ns)
    contact_ns = onset_ns - late_ms * MS
    heard = actuator.delivered(contact_ns)
    assert heard is not None
    assert heard.onset_ns is not None
    off_ms = (heard.onset_ns - contact_ns) / MS
    assert not heard.delivered
    assert re.findall(r"([+-]?[\d.]+) ms", heard.reason) == [f"{off_ms:+.2f}", "5"]


def test_an_inverse_begins_ahead_and_what_it_makes_meets_the_contact(
    actuator: Actuator, stream: AudioStream, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames are those that the stream is given: what the machine's load does to its time is left out."""
    lines = np.arange(5, 2001)
    alike = Reference(lines, np.full(lines.size, 64.0 + 0j), np.zeros(lines.size))
    movement = Movement(alike, stated(full_scale_m_s2=64.0), stream.rate_hz)
    inverse = Inverse(movement, ahead_s=0.02)
    condition = Conditioner(full_scale=64.0, limit_m_s2=20.0, movement=movement, inverse=inverse)
    assert RIG.audio is not None
    inverted = AudioActuator(stream, RIG.audio, condition)
    assert inverted.lead_ns - actuator.lead_ns == 20 * MS
    wave = 5.0 * np.hanning(4800) * np.sin(2 * np.pi * 150.0 / stream.rate_hz * np.arange(4800))
    onset_ns, begun, move = CLOCK.now_ns() + 500 * MS, list[int](), stream.move
    at = stream.next_frame + 24_000

    def noted(cue: Cue, frame: int) -> bool:
        begun.append(frame)
        return move(cue, frame)

    with monkeypatch.context() as steady:
        steady.setattr(stream, "frame_at", lambda ns: at + round((ns - onset_ns) * 48e-6))
        steady.setattr(stream, "move", noted)
        for one in (actuator, inverted):
            one.prepare(given(wave, rate_hz=stream.rate_hz))
            assert one.aim(onset_ns)
    assert begun[0] - begun[1] == 960
    heard = inverted.delivered(onset_ns)
    assert heard is not None
    assert heard.onset_ns is not None
    assert heard.onset_ns == pytest.approx(stream.ns_of(begun[0]) + OUTPUT_MS * MS, abs=5 * MS)


@pytest.mark.parametrize("landed", [False, True], ids=["aimed", "landed"])
def test_a_withdrawn_stimulus_is_not_felt(actuator: Actuator, panel: CardPanel, landed: bool, refuses: Refuses) -> None:
    """Another thread may withdraw it right before or after the landing is reported."""
    with refuses(ActuatorError):
        actuator.delivered(CLOCK.now_ns())
    actuator.prepare(given(stimulus()))
    if not landed:
        assert actuator.aim(CLOCK.now_ns() + 60 * MS)
    assert actuator.withdraw()
    if landed:
        actuator.landed(CLOCK.now_ns())
    assert panel.felt(0.2) is None
    assert actuator.withdraw()
    assert actuator.is_silent()
    heard = actuator.delivered(CLOCK.now_ns())
    assert heard is not None
    assert (heard.delivered, heard.reason) == (False, TAKEN_BACK)


def test_what_is_withdrawn_while_it_is_waited_for_was_not_delivered(actuator: Actuator, stream: AudioStream) -> None:
    actuator.prepare(given(stimulus()))
    assert actuator.aim(CLOCK.now_ns() + 200 * MS)
    withdrawing = threading.Timer(0.05, actuator.withdraw)
    withdrawing.start()
    heard = actuator.delivered(CLOCK.now_ns())
    withdrawing.join()
    assert heard is not None
    assert (heard.delivered, heard.reason) == (False, TAKEN_BACK)


def test_a_later_stimulus_takes_the_place_of_one_that_waits(actuator: Actuator, panel: CardPanel) -> None:
    actuator.prepare(given(stimulus(1)))
    assert actuator.aim(CLOCK.now_ns() + 60 * MS)
    actuator.prepare(given(stimulus(2)))
    actuator.landed(CLOCK.now_ns())
    heard = actuator.delivered(CLOCK.now_ns())
    assert heard is not None
    assert heard.gain == 1.0
    felt = panel.felt(1.0)
    assert felt is not None
    assert felt == pytest.approx(stimulus(2), abs=1e-5)
    assert panel.felt(0) is None


def test_a_pulled_loopback_and_a_soft_one_are_not_delivered(
    actuator: Actuator, card: SoundCard, stream: AudioStream, approved: SnapshotAssertion
) -> None:
    card.disconnect(2)
    actuator.prepare(given(stimulus()))
    actuator.landed(CLOCK.now_ns())
    unheard = actuator.delivered(CLOCK.now_ns())
    assert unheard is not None
    assert (unheard.delivered, unheard.onset_ns) == (False, None)
    assert unheard.reason == approved
    card.connect(3, 2)
    assert RIG.audio is not None
    louder = headless(latency=RIG.audio.latency.model_copy(update={"loopback_gain": 2.0}))
    other = opening.open_actuator(louder, limit_m_s2=20.0, stream=stream)
    other.prepare(given(stimulus()))
    other.landed(CLOCK.now_ns())
    soft = other.delivered(CLOCK.now_ns())
    assert soft is not None
    assert not soft.delivered
    assert re.findall(r"([+-]?[\d.]+) dB", soft.reason) == ["-6.0", "1"]


def test_an_intended_silence_is_delivered(actuator: Actuator) -> None:
    actuator.prepare(given(np.zeros(480)))
    onset_ns = CLOCK.now_ns() + 60 * MS
    assert actuator.aim(onset_ns)
    heard = actuator.delivered(onset_ns)
    assert heard is not None
    assert (heard.delivered, heard.onset_ns, heard.gain) == (True, None, None)


def test_an_intended_silence_in_which_something_sounds_is_not_delivered(
    actuator: Actuator, stream: AudioStream
) -> None:
    assert RIG.audio is not None
    actuator.prepare(given(np.zeros(4800)))
    # The conditioner's limit of 20 m/s^2 is 0.31 of full scale.
    stream.schedule(np.full(9600, 0.25), channel=RIG.audio.channels.actuator - 1, frame=AT_ONCE)
    actuator.landed(CLOCK.now_ns())
    heard = actuator.delivered(CLOCK.now_ns())
    assert heard is not None
    assert (heard.delivered, heard.onset_ns) == (False, None)
    assert re.findall(r"([+-]?[\d.]+) dB", heard.reason) == ["-12.0", "-20"]


def test_a_start_that_a_standing_stream_missed_is_on_record(
    actuator: Actuator,
    stream: AudioStream,
    panel: CardPanel,
    monkeypatch: pytest.MonkeyPatch,
    approved: SnapshotAssertion,
) -> None:
    # The stream's counter is past the frame when the callback comes to it, as after a callback that came too late.
    actuator.prepare(given(stimulus()))
    monkeypatch.setattr(AudioStream, "next_frame", property(lambda _: 0))
    monkeypatch.setattr(AudioStream, "frame_at", lambda self, _: self._mixer.frame - 5 * self.lead_frames)
    assert actuator.aim(CLOCK.now_ns())
    monkeypatch.undo()
    missed = actuator.delivered(CLOCK.now_ns())
    assert missed is not None
    assert (missed.delivered, missed.onset_ns) == (False, None)
    assert missed.reason == approved
    assert panel.felt(0.1) is None


def test_a_calibration_that_is_too_old_is_refused_before_anything_is_opened() -> None:
    real = RIG.model_copy(update={"rig": RIG.rig.model_copy(update={"simulated": False})})
    made = DAY - timedelta(days=1)
    for day, said in ((made + timedelta(days=31), "31 days old"), (made - timedelta(days=1), "-1 days old")):
        with pytest.raises(RigError, match=rf"audio\.latency: .* {said} on .*; allowed: 0 to 30 days; run"):
            opening_audio.open_audio(
                real, limits_m_s2={None: 20.0}, listens=False, masker=None, clock=CLOCK, today=day, device=DEVICE
            )
