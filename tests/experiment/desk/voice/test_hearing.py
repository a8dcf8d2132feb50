"""From microphone and masker to an answer, with sounds that are made up here: chirps for words."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment.desk.voice.hearing import SILENCE, Heard, hear, listen, take
from palpate.experiment.desk.voice.matching import Enrolment, enrolled
from palpate.experiment.errors import VoiceError
from tests.approved import Refuses

RATE_HZ = 48_000
ANSWERABLE_S = 2.0
GLIDES_HZ = {"paper": (300.0, 3000.0), "foil": (3000.0, 300.0), "film": (1000.0, 1000.0)}
"""From and to what frequency a word glides."""


def word(name: str, lasts_s: float = 0.5) -> NDArray[np.float64]:
    """Return a glide with harmonics, shape (n,)."""
    low, high = GLIDES_HZ.get(name, (600.0, 6000.0))
    t = np.arange(round(lasts_s * RATE_HZ)) / RATE_HZ
    phase = 2 * np.pi * (low * t + (high - low) * t**2 / 2 / lasts_s)
    return 0.1 * (np.sin(phase) + 0.5 * np.sin(2 * phase))


def recording(
    *words: tuple[str, float, float], masker: float = 0.2, room: float = 1e-4, lasts_s: float = 4.5
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return microphone and masker, for words, when they begin and how long they last, s; the rms of leak and room."""
    rng = np.random.default_rng(0)
    played = rng.normal(size=round(lasts_s * RATE_HZ))
    path = np.random.default_rng(1).normal(size=2000) * np.exp(-np.arange(2000) / 300)
    microphone = masker * np.convolve(played, path / np.linalg.norm(path))[: played.size]
    microphone += room * rng.normal(size=played.size)
    for name, at_s, long_s in words:
        made, at = word(name, long_s), round(at_s * RATE_HZ)
        microphone[at : at + made.size] += made
    return microphone, played


@pytest.fixture(scope="module")
def enrolment() -> Enrolment:
    return enrolled(
        {
            name: [
                take(*recording((name, 2.5, long_s), masker=0.0), rate_hz=RATE_HZ, answerable_s=ANSWERABLE_S)
                for long_s in (0.45, 0.6)
            ]
            for name in GLIDES_HZ
        }
    )


def heard(made: tuple[NDArray[np.float64], NDArray[np.float64]], enrolment: Enrolment) -> Heard:
    return hear(*made, rate_hz=RATE_HZ, answerable_s=ANSWERABLE_S, enrolment=enrolment)


@pytest.mark.parametrize("name", GLIDES_HZ)
@pytest.mark.parametrize("at_s", [2.1, 2.7, 3.5])
def test_an_answer_under_a_masker_that_is_louder(enrolment: Enrolment, name: str, at_s: float) -> None:
    found = heard(recording((name, at_s, 0.5)), enrolment)
    assert found.proposed == name
    assert found.onset_s == pytest.approx(at_s, abs=0.002)
    assert found.agreement >= 0.7
    assert found.lead > 0


def test_a_background_that_was_listened_to_before_gives_the_same(enrolment: Enrolment) -> None:
    microphone, played = recording(("foil", 2.6, 0.5))
    before = slice(None, round(ANSWERABLE_S * RATE_HZ))
    background = listen(microphone[before], played[before], rate_hz=RATE_HZ)
    found = hear(
        microphone,
        played,
        rate_hz=RATE_HZ,
        answerable_s=ANSWERABLE_S,
        enrolment=enrolment,
        background=background,
    )
    assert found == heard((microphone, played), enrolment)


def test_somebody_who_speaks_before_changes_nothing(enrolment: Enrolment) -> None:
    found = heard(recording(("something else", 0.9, 0.5), ("foil", 2.6, 0.5)), enrolment)
    assert found.proposed == "foil"
    assert found.onset_s == pytest.approx(2.6, abs=0.002)
    assert found.agreement == pytest.approx(heard(recording(("foil", 2.6, 0.5)), enrolment).agreement, abs=0.02)


def test_levels_of_both_channels_do_not_matter(enrolment: Enrolment) -> None:
    microphone, played = recording(("paper", 2.6, 0.5))
    one, other = (heard(each, enrolment) for each in ((microphone, played), (0.01 * microphone, 3 * played)))
    assert other.proposed == one.proposed == "paper"
    assert other.onset_s == one.onset_s
    assert other.agreement == pytest.approx(one.agreement, abs=1e-3)


def test_another_word_has_an_onset_and_is_not_proposed(enrolment: Enrolment) -> None:
    found = heard(recording(("something else", 2.7, 0.5)), enrolment)
    assert found.proposed is None
    assert found.onset_s == pytest.approx(2.7, abs=0.002)


def test_a_word_before_the_answer_is_passed_over(enrolment: Enrolment) -> None:
    found = heard(recording(("something else", 2.2, 0.3), ("foil", 3.2, 0.5)), enrolment)
    assert found.proposed == "foil"
    assert found.onset_s == pytest.approx(3.2, abs=0.002)


def test_an_answer_within_another_sound_begins_where_it_begins(enrolment: Enrolment) -> None:
    microphone, played = recording(("foil", 2.5, 0.5))
    sound = 0.01 * np.random.default_rng(2).normal(size=RATE_HZ // 2)
    microphone[round(2.05 * RATE_HZ) :][: sound.size] += sound
    found = heard((microphone, played), enrolment)
    assert found.proposed == "foil"
    assert found.onset_s == pytest.approx(2.5, abs=0.01)


def test_two_different_answers_are_left_to_the_experimenter(enrolment: Enrolment) -> None:
    found = heard(recording(("paper", 2.2, 0.5), ("foil", 3.3, 0.5)), enrolment)
    assert found.proposed is None
    assert found.onset_s == pytest.approx(2.2, abs=0.002)
    same = heard(recording(("paper", 2.2, 0.5), ("paper", 3.3, 0.5)), enrolment)
    assert same.proposed == "paper"


@pytest.mark.parametrize("masker", [0.0, 0.2, 1e3])
def test_silence_under_any_masker_is_silence(enrolment: Enrolment, masker: float) -> None:
    assert heard(recording(masker=masker), enrolment) == SILENCE


@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_a_microphone_that_is_dead_or_stuck_hears_nothing(enrolment: Enrolment, value: float) -> None:
    dead = np.full(4 * RATE_HZ, value)
    assert heard((dead, np.zeros_like(dead)), enrolment) == SILENCE
    assert heard((dead, np.random.default_rng(0).normal(size=dead.size)), enrolment) == SILENCE


def test_a_clipped_answer_is_heard(enrolment: Enrolment) -> None:
    microphone, played = recording(("foil", 2.6, 0.5), masker=0.01)
    found = heard((np.clip(microphone, -0.1, 0.1), played), enrolment)
    assert found.proposed == "foil"
    assert found.onset_s == pytest.approx(2.6, abs=0.002)


@pytest.mark.parametrize("left_s", [0.0, 0.001, 0.02, 0.1])
def test_a_recording_that_ends_at_once_holds_nothing(enrolment: Enrolment, left_s: float) -> None:
    microphone, played = (each[: round((ANSWERABLE_S + left_s) * RATE_HZ)] for each in recording())
    assert heard((microphone, played), enrolment) == SILENCE


@pytest.mark.parametrize("answerable_s", [-1.0, 0.0, 0.49, 9.0])
def test_a_time_outside_of_the_recording_is_refused(
    enrolment: Enrolment, answerable_s: float, refuses: Refuses
) -> None:
    with refuses(VoiceError):
        hear(*recording(), rate_hz=RATE_HZ, answerable_s=answerable_s, enrolment=enrolment)


def test_channels_of_other_moments_are_refused(enrolment: Enrolment, refuses: Refuses) -> None:
    microphone, played = recording()
    with refuses(VoiceError):
        heard((microphone, played[1:]), enrolment)
    with refuses(VoiceError):
        listen(microphone[1:], played, rate_hz=RATE_HZ)


def test_a_take_is_one_utterance() -> None:
    for words, number in (((), 0), ((("paper", 2.2, 0.5), ("paper", 3.3, 0.5)), 2)):
        with pytest.raises(VoiceError, match=f"enrolment: got {number} utterances; allowed: one utterance"):
            take(*recording(*words), rate_hz=RATE_HZ, answerable_s=ANSWERABLE_S)
