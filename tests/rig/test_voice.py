"""Answers that espeak-ng and flite say in a simulated room, under the masker: SYNTHETIC speech, which says nothing of
people. The figures of the whole corpus are those of `python -m tests.benchmarks.voice`.
"""

from __future__ import annotations

import numpy as np
import pytest

from palpate.experiment.desk.voice.features import RATE_HZ as BAND_HZ
from palpate.experiment.desk.voice.features import banded
from palpate.experiment.desk.voice.hearing import cancelled, listen
from tests.benchmarks import voice as benchmark
from tests.rig import speech
from tests.rig.speech import ANSWERABLE_S, RATE_HZ

pytestmark = pytest.mark.clocked

VOICES = tuple(voice for voice in speech.TESTED if voice.name in ("en-us+f2", "ja+m2", "slt"))


@pytest.fixture(scope="module", autouse=True)
def _synthesisers() -> None:
    if missing := speech.missing():
        pytest.skip(f"needs {' and '.join(missing)} (packages espeak-ng, flite)")


@pytest.mark.parametrize("voice", [*speech.TESTED, *speech.TRIED], ids=str)
def test_before_the_true_onset_a_voice_is_silent_and_says_the_same_every_time(voice: speech.Voice) -> None:
    said = speech.say(voice, speech.ANSWERS[voice.language][0])
    again = speech.say.__wrapped__(voice, speech.ANSWERS[voice.language][0])
    assert np.array_equal(said, again)
    assert np.max(np.abs(said[: speech.risen(said)])) <= speech.RISEN * np.max(np.abs(said))
    assert speech.risen(said) > 0.02 * RATE_HZ


def test_no_voice_that_is_tested_was_tried() -> None:
    assert not set(speech.TESTED) & set(speech.TRIED)
    for voices in (speech.TESTED, speech.TRIED):
        assert {voice.language for voice in voices} == {"en", "ja"}
        assert {voice.sex for voice in voices} == {"f", "m"}
        assert {voice.program for voice in voices} == {"espeak-ng", "flite"}


def test_the_masker_is_cancelled_to_the_noise_of_the_room() -> None:
    rng = np.random.default_rng(5)
    made = speech.record(speech.say(VOICES[0], "copy paper"), snr_db=0, rng=rng, after_s=(1.0, 1.2))
    until = round(ANSWERABLE_S * RATE_HZ)
    background = listen(made.microphone[:until], made.played[:until], rate_hz=RATE_HZ)
    microphone, played = (banded(each, rate_hz=RATE_HZ) for each in (made.microphone, made.played))
    left = cancelled(microphone, played, background.taps)
    silent = slice(round(ANSWERABLE_S * BAND_HZ), round((made.onset_s - 0.05) * BAND_HZ))
    # The room's own noise is 35 dB below the speech, and here the masker is as loud as that.
    assert 20 * np.log10(np.std(microphone[silent]) / np.std(left[silent])) > 29


@pytest.mark.parametrize("snr_db", [20, 0])
def test_answers_are_timed_and_proposed_and_other_words_refused(snr_db: int) -> None:
    found = list(benchmark.trials(VOICES, snr_db=snr_db, speeds=(0.8, 1.25)))
    answers = [each for each in found if each.answer is not None]
    others = [each for each in found if each.answer is None]
    errors_ms = [1e3 * abs((each.heard.onset_s or np.inf) - each.onset_s) for each in answers]
    assert np.median(errors_ms) <= 3
    assert np.quantile(errors_ms, 0.95) <= 30
    assert np.mean([each.heard.proposed == each.answer for each in answers]) >= 0.97
    assert np.mean([each.heard.proposed is None for each in others]) >= 0.95


def test_without_cancelling_they_would_not_be() -> None:
    found = benchmark.trials(VOICES, snr_db=0, cancelling=False, speeds=(0.8,))
    answers = [each for each in found if each.answer is not None]
    assert np.mean([each.heard.proposed == each.answer for each in answers]) < 0.5
