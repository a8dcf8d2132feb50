"""From the microphone and the masker to what was said, when, and how sure that is.

`listen` learns the masker's leak and the quiet, which takes most of the time, while the foot is awaited. `hear` takes
the masker out, finds the utterances, and matches each against the enrolment, whose takes `take` prepares.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, linalg

from palpate.experiment.desk.voice import onset
from palpate.experiment.desk.voice.features import HOP, RATE_HZ, banded, cepstra
from palpate.experiment.desk.voice.matching import AGREES, Enrolment, Match, Take, match
from palpate.experiment.errors import VoiceError

Samples = NDArray[np.floating[Any]]
"""A channel of the stream, full scale 1, shape (n,)."""

TAPS = 1920
"""Of the filter: 120 ms in the band, of which a room and the latency of the device take their parts."""

SHORTEST = 3 * TAPS
"""Fewer samples than these determine no filter: 0.36 s."""

_RIDGE = 1e-6
"""Of the played power, added to the diagonal: where x has no power, as at the band's end, h stays 0."""

_TURNS, _SOLVED = 20, 1e-4
"""Most turns, and the residual of the normal equations at which to stop: it adds about -80 dB of the masker."""

LISTENED_S = 3.5
"""At most so long before an answer is listened to, s."""

BEFORE_S = 0.5
"""So long before an answer may begin the recording must, s: for the filter, and for the quiet before the onset."""

_AROUND = round(0.05 * RATE_HZ)
"""Samples around what was said into the background that are left out as well: its softest parts."""

_CONTEXT = round(0.3 * RATE_HZ)
_LONGEST = 2.0
"""Times the longest take: what comes earlier in an utterance is left out."""


@dataclass(frozen=True, eq=False)
class Background:
    """What the microphone hears while nobody speaks: the masker's leak, shape (TAPS,), and the quiet without it."""

    taps: NDArray[np.float64]
    quiet: onset.Quiet


@dataclass(frozen=True)
class Heard:
    """What was said after an answer was allowed.

    Attributes:
        onset_s: when the voice began, s after the first sample; of the proposed answer, or else of the first utterance;
            None where nobody spoke.
        proposed: the answer; None where nobody spoke, no utterance is an answer, or two are different ones.
        agreement: of the nearest answer, from 0 (as far as another answer) to 1 (as near as a take of it).
        lead: how much further the next answer is, in the same unit.
        until_s: when the last utterance ended, s after the first sample; None where nobody spoke.
    """

    onset_s: float | None
    proposed: str | None
    agreement: float
    lead: float
    until_s: float | None = None


SILENCE = Heard(None, None, 0.0, 0.0)


def listen(microphone: Samples, played: Samples, *, rate_hz: int) -> Background:
    """Return what the microphone hears while nobody speaks, from samples of it and of what the masker played.

    Both are of the same moments, 0.36 s or more; the last `LISTENED_S` count, less those in which somebody speaks.
    Raises `VoiceError` for fewer or unlike samples, and as `banded`.
    """
    _alike(microphone, played)
    last = slice(-round(LISTENED_S * rate_hz), None)
    heard, masker = (banded(each[last], rate_hz=rate_hz) for each in (microphone, played))
    taps = leak(heard, masker)
    left = cancelled(heard, masker, taps)
    quiet = onset.quiet(left[TAPS:])
    spoken = onset.utterances(left, after=TAPS, quiet=quiet)
    counted = np.ones(left.size, np.bool_)
    for each in spoken:
        counted[each.begins[0] - _AROUND : each.end + _AROUND] = False
    if spoken and np.count_nonzero(counted) >= SHORTEST:
        taps = leak(heard, masker, counted)
        quiet = onset.quiet(cancelled(heard, masker, taps)[TAPS:][counted[TAPS:]])
    return Background(taps, quiet)


def take(
    microphone: Samples, played: Samples, *, rate_hz: int, answerable_s: float, background: Background | None = None
) -> Take:
    """Return the take of an answer that is said once, `answerable_s` after the first sample or later.

    Raises `VoiceError` for no utterance or several, and as `hear`.
    """
    samples, utterances, _, _ = _utterances(microphone, played, rate_hz, answerable_s, background)
    if len(utterances) != 1:
        raise VoiceError(
            "enrolment",
            f"got {len(utterances)} utterances",
            "have the participant repeat only the answer, close to the microphone",
            allowed="one utterance, the answer",
        )
    return cepstra(samples[utterances[0].begins[0] : utterances[0].end])


def ended_s(
    microphone: Samples, played: Samples, *, rate_hz: int, answerable_s: float, background: Background
) -> float | None:
    """Return when the last utterance ended, s after the first sample; None where nobody spoke. Arguments as `take`."""
    _, utterances, begin_s, _ = _utterances(microphone, played, rate_hz, answerable_s, background)
    return begin_s + utterances[-1].end / RATE_HZ if utterances else None


def hear(
    microphone: Samples,
    played: Samples,
    *,
    rate_hz: int,
    answerable_s: float,
    enrolment: Enrolment,
    background: Background | None = None,
) -> Heard:
    """Return what was said, `answerable_s` after the first sample or later.

    The microphone and the played masker are of the same moments; they begin `BEFORE_S` or more before an answer is
    allowed, and should end with a quarter of a second of silence. The `background` is by default from before. Raises
    `VoiceError` for unlike samples or a late begin, and as `banded`.
    """
    samples, utterances, begin_s, quiet = _utterances(microphone, played, rate_hz, answerable_s, background)
    if not utterances:
        return SILENCE
    longest = round(_LONGEST * max(len(one) for one in enrolment.takes)) * HOP
    until_s = begin_s + utterances[-1].end / RATE_HZ
    found = [_matched(samples, each, longest, enrolment, quiet) for each in utterances]
    answers = [one for one in found if one[0].agreement >= AGREES]
    if not answers:
        nearest = max((matched for matched, _ in found), key=lambda one: one.agreement)
        return Heard(begin_s + utterances[0].begins[0] / RATE_HZ, None, nearest.agreement, nearest.lead, until_s)
    matched, begin = answers[0]
    alone = all(other.answer == matched.answer for other, _ in answers)
    proposed = matched.answer if alone else None
    return Heard(begin_s + begin / RATE_HZ, proposed, matched.agreement, matched.lead, until_s)


def without_masker(
    microphone: Samples, played: Samples, *, rate_hz: int, background: Background
) -> NDArray[np.float64]:
    """Return what the microphone heard but for the masker, at `RATE_HZ`, for somebody to listen to, shape (m,)."""
    _alike(microphone, played)
    heard, masker = (banded(each, rate_hz=rate_hz) for each in (microphone, played))
    return cancelled(heard, masker, background.taps)


def _matched(
    samples: NDArray[np.float64], utterance: onset.Utterance, longest: int, enrolment: Enrolment, quiet: onset.Quiet
) -> tuple[Match, int]:
    """Return what an utterance is nearest to, and the sample from which it is; what is too long is cut before that."""
    first = max(utterance.begins[0], utterance.end - longest)
    frames = cepstra(samples[first : utterance.end])
    begins = {min(round((begin - first) / HOP), len(frames) - 1): begin for begin in utterance.begins if begin >= first}
    matched = match(frames, enrolment, list(begins) or [0])
    if matched.begin in begins:
        return matched, begins[matched.begin]
    return matched, onset.risen(samples, near=first + matched.begin * HOP, quiet=quiet)


def _utterances(
    microphone: Samples, played: Samples, rate_hz: int, answerable_s: float, background: Background | None
) -> tuple[NDArray[np.float64], tuple[onset.Utterance, ...], float, onset.Quiet]:
    """Return samples in the band without the masker, the utterances in them, when they begin, s, and the quiet."""
    _alike(microphone, played)
    answerable = round(answerable_s * rate_hz)
    first = answerable - round(BEFORE_S * rate_hz)
    if not 0 <= first <= microphone.size:
        raise VoiceError(
            "answerable_s",
            f"got {answerable_s:g} s in a recording of {microphone.size / rate_hz:g} s",
            "record more of the stream",
            allowed=f"between {BEFORE_S:g} s after its start and its end",
        )
    if background is None:
        background = listen(microphone[:answerable], played[:answerable], rate_hz=rate_hz)
    heard, masker = (banded(each[first:], rate_hz=rate_hz) for each in (microphone, played))
    samples = cancelled(heard, masker, background.taps)
    after = round(BEFORE_S * RATE_HZ)
    skipped = after - _CONTEXT
    utterances = onset.utterances(samples[skipped:], after=_CONTEXT, quiet=background.quiet)
    return samples[skipped:], utterances, first / rate_hz + skipped / RATE_HZ, background.quiet


def _alike(microphone: Samples, played: Samples) -> None:
    if microphone.shape != played.shape:
        raise VoiceError(
            "microphone",
            f"got shape {microphone.shape} for the microphone and {played.shape} for the masker",
            "check the driver",
            allowed="two channels of equal length",
        )


def leak(
    microphone: NDArray[np.float64], played: NDArray[np.float64], counted: NDArray[np.bool_] | None = None
) -> NDArray[np.float64]:
    """Return the filter from played samples to the microphone, shape (TAPS,), 0 where nothing was played.

    Both are in the band, at the same moments, shape (n,), with n of `SHORTEST` or more. Samples that are not `counted`,
    shape (n,), are speech, which would add as much error as noise. Raises `VoiceError` for other shapes.
    """
    if microphone.shape != played.shape or microphone.ndim != 1 or microphone.size < SHORTEST:
        raise VoiceError(
            "microphone",
            f"got shape {microphone.shape} for the microphone and {played.shape} for the masker",
            "record for longer before the answer",
            allowed=f"two rows of {SHORTEST} samples or more, {SHORTEST / 16000:g} s",
        )
    weights = np.ones(microphone.size - TAPS + 1) if counted is None else counted[TAPS - 1 :].astype(np.float64)
    y, whole = weights * microphone[TAPS - 1 :], fft.next_fast_len(microphone.size, real=True)
    x = fft.rfft(played, whole)

    def correlated(row: NDArray[np.float64]) -> NDArray[np.float64]:
        correlation: NDArray[np.float64] = fft.irfft(np.conj(fft.rfft(row, whole)) * x, whole)
        return correlation[TAPS - 1 :: -1]

    def filtered(h: NDArray[np.float64]) -> NDArray[np.float64]:
        wave: NDArray[np.float64] = fft.irfft(fft.rfft(h, whole) * x, whole)
        return weights * wave[TAPS - 1 : microphone.size]

    power = fft.irfft(np.abs(x) ** 2, whole)[:TAPS].copy()
    h = np.zeros(TAPS)
    if power[0] == 0:
        return h
    ridge = _RIDGE * power[0]
    power[0] += ridge
    residual = correlated(y)
    enough = _SOLVED * float(np.linalg.norm(residual))
    direction, before = h, 1.0
    for _ in range(_TURNS):
        if np.linalg.norm(residual) <= enough:
            break
        conditioned = linalg.solve_toeplitz(power, residual, check_finite=False)
        now = float(residual @ conditioned)
        direction = conditioned + now / before * direction
        mapped = correlated(filtered(direction)) + ridge * direction
        step = now / float(direction @ mapped)
        h = h + step * direction
        residual = residual - step * mapped
        before = now
    return h


def cancelled(
    microphone: NDArray[np.float64], played: NDArray[np.float64], taps: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the microphone less `taps` of the played samples, shape (n,); the first `taps.size` lack the past."""
    if not np.any(taps):
        return microphone
    n = fft.next_fast_len(microphone.size + taps.size, real=True)
    leaked: NDArray[np.float64] = fft.irfft(fft.rfft(played, n) * fft.rfft(taps, n), n)[: microphone.size]
    return microphone - leaked
