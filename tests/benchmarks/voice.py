"""What is heard of SYNTHETIC speech: run `python -m tests.benchmarks.voice`, or with `thresholds`, or `disturbed`.

espeak-ng and flite say answers and words that are none, in a simulated room with the masker in the microphone; see
`tests/rig/speech.py`, which also says what the true onset is. Each voice is a participant, with two takes of each
answer recorded without the masker. Printed, by the speech's level over the masker: how far the onset that was found is
from the true one; answers that were proposed rightly, refused, and taken for another; words that are no answer and were
refused; and, in milliseconds of processor time, what listening costs, which is done while the foot is awaited, and what
an answer costs after that. Beside it the same without cancelling.

`thresholds` prints what `AGREES` of `matching.py` was set by, with other voices; `disturbed` prints, at 10 dB, what
coughs, clicks, the step's sound, hum, clipping, louder rooms, people who move and answers of one syllable do.

Not a test: it asserts nothing. Synthetic speech says nothing of real participants.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.experiment.desk.voice.hearing import Heard, hear, listen, take
from palpate.experiment.desk.voice.matching import Enrolment, enrolled
from tests.rig import speech
from tests.rig.speech import ANSWERABLE_S, RATE_HZ, Recording, Voice

SNRS_DB = (20, 10, 0)


@dataclass(frozen=True)
class Trial:
    """What was said, None being no answer; what was heard, the true onset, and the processor time of both, s."""

    answer: str | None
    heard: Heard
    onset_s: float
    listened_s: float
    heard_s: float


@cache
def enrolment(voice: Voice, answers: tuple[str, ...]) -> Enrolment:
    """Return what a voice enrolled, each answer at two speeds and pitches, without the masker."""
    rng = np.random.default_rng([0, *str(voice).encode()])
    takes = {
        answer: [
            take(made.microphone, made.played, rate_hz=RATE_HZ, answerable_s=ANSWERABLE_S)
            for speed, pitch in speech.ENROLLED
            for made in [speech.record(speech.say(voice, answer, speed, pitch), snr_db=None, rng=rng)]
        ]
        for answer in answers
    }
    return enrolled(takes)


def heard(answer: str | None, made: Recording, enrolment: Enrolment) -> Trial:
    begun = time.process_time()
    before = slice(None, round(ANSWERABLE_S * RATE_HZ))
    background = listen(made.microphone[before], made.played[before], rate_hz=RATE_HZ)
    listened = time.process_time()
    found = hear(
        made.microphone,
        made.played,
        rate_hz=RATE_HZ,
        answerable_s=ANSWERABLE_S,
        enrolment=enrolment,
        background=background,
    )
    return Trial(answer, found, made.onset_s, listened - begun, time.process_time() - listened)


def trials(
    voices: Sequence[Voice],
    *,
    snr_db: float,
    cancelling: bool = True,
    speeds: Sequence[float] = speech.SPEEDS,
    answers: Mapping[str, tuple[str, ...]] = speech.ANSWERS,
    others: Mapping[str, tuple[str, ...]] = speech.NO_ANSWERS,
    **kept: Any,
) -> Iterator[Trial]:
    """Return what is heard of every voice: answers at every speed, others at the voice's own; by language."""
    for number, voice in enumerate(voices):
        rng = np.random.default_rng([number, int(snr_db)])
        said = enrolment(voice, answers[voice.language])
        words: list[tuple[str | None, str, float]]
        words = [(answer, answer, speed) for answer in answers[voice.language] for speed in speeds]
        words += [(None, word, 1.0) for word in others[voice.language]]
        for answer, word, speed in words:
            made = speech.record(
                speech.say(voice, word, speed, rng.uniform(0.92, 1.08)), snr_db=snr_db, rng=rng, **kept
            )
            if not cancelling:
                made = replace(made, played=np.zeros_like(made.played))
            yield heard(answer, made, said)


def line(name: str, found: Sequence[Trial]) -> str:
    """Return a row of the table."""
    answers = [each for each in found if each.answer is not None]
    others = [each for each in found if each.answer is None]
    errors_ms = np.array(
        [np.inf if each.heard.onset_s is None else 1e3 * abs(each.heard.onset_s - each.onset_s) for each in answers]
    )
    right = np.mean([each.heard.proposed == each.answer for each in answers])
    refused = np.mean([each.heard.proposed is None for each in answers])
    kept_out = np.mean([each.heard.proposed is None for each in others])
    return (
        f"| {name} | {len(answers)} | {_quantile(errors_ms, 0.5):.1f} | {_quantile(errors_ms, 0.95):.1f} | "
        f"{right:.1%} | {refused:.1%} | {abs(1 - right - refused):.1%} | {len(others)} | {kept_out:.1%} | "
        f"{1e3 * np.median([each.listened_s for each in found]):.0f} | "
        f"{1e3 * np.median([each.heard_s for each in found]):.0f} |"
    )


def _quantile(errors_ms: NDArray[np.float64], part: float) -> float:
    """Return a quantile that is an error of some answer, infinite where nobody was heard."""
    return float(np.quantile(errors_ms, part, method="higher"))


HEAD = (
    "| condition | answers | onset, median ms | 95th percentile | proposed rightly | refused | wrongly | no answers | "
    "refused | listening, ms | an answer, ms |\n|:--|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|"
)


def thresholds() -> None:
    """Print the agreement of answers and of words that are none."""
    found = [trial for snr_db in SNRS_DB for trial in trials(speech.TRIED, snr_db=snr_db)]
    for name, none, quantiles in (("answers", False, (0, 0.01, 0.03, 0.5)), ("no answers", True, (0.5, 0.95, 0.99, 1))):
        agreed = [each.heard.agreement for each in found if (each.answer is None) is none]
        shown = ", ".join(f"{q:.0%}: {np.quantile(agreed, q):.2f}" for q in quantiles)
        print(f"agreement of {len(agreed)} {name}: {shown}")


def disturbed() -> None:
    """Print the table of disturbances."""
    conditions: dict[str, dict[str, Any]] = {
        "nothing": {},
        "a cough 0.8 s before": {"disturbed": speech.coughed, "after_s": (0.9, 1.2)},
        "a click 0.15 s before": {"disturbed": speech.clicked},
        "the step's sound, answered in 0.15 to 0.3 s": {"disturbed": speech.stepped, "after_s": (0.15, 0.3)},
        "somebody speaks 2 s before the step": {"disturbed": speech.talked},
        "hum at -10 dB": {"disturbed": speech.hummed},
        "clipped at a third of the peak": {"disturbed": speech.clipped},
        "ambient noise at -25 dB": {"ambient_db": -25.0},
        "ambient noise at -15 dB": {"ambient_db": -15.0},
        "the leak's path changed by -20 dB": {"moved_db": -20.0},
        "the leak's path changed by -10 dB": {"moved_db": -10.0},
    }
    few = {language: words[:4] for language, words in speech.NO_ANSWERS.items()}
    print(HEAD)
    for name, kept in conditions.items():
        print(line(name, list(trials(speech.TESTED, snr_db=10, speeds=(0.8,), others=few, **kept))), flush=True)
    english = [voice for voice in speech.TESTED if voice.language == "en"]
    for name, others in (
        ("short answers", speech.NO_ANSWERS),
        ("short answers, and words like them", speech.LIKE_SHORT),
    ):
        found = trials(english, snr_db=10, speeds=(0.8,), answers=speech.SHORT_ANSWERS, others=others)
        print(line(name, list(found)), flush=True)


def main() -> None:
    print(
        f"SYNTHETIC speech of {len(speech.TESTED)} voices; load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} "
        "cores. Synthetic speech says nothing of real participants."
    )
    if "thresholds" in sys.argv[1:]:
        thresholds()
    elif "disturbed" in sys.argv[1:]:
        disturbed()
    else:
        print(HEAD)
        for cancelling in (True, False):
            for snr_db in SNRS_DB:
                name = f"{snr_db} dB" if cancelling else f"{snr_db} dB, not cancelled"
                print(line(name, list(trials(speech.TESTED, snr_db=snr_db, cancelling=cancelling))), flush=True)


if __name__ == "__main__":
    main()
