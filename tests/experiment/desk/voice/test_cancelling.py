"""The filter against a known one, and against numpy's least squares over the whole matrix of its equations."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment.desk.voice import hearing
from palpate.experiment.desk.voice.hearing import SHORTEST, TAPS, cancelled, leak
from palpate.experiment.errors import VoiceError
from palpate.experiment.synthesis.signals.noise import noise
from tests.approved import Refuses


def white(samples: int, seed: int = 0) -> NDArray[np.float64]:
    return np.random.default_rng(seed).normal(size=samples)


def room(taps: int, seed: int = 1) -> NDArray[np.float64]:
    """Return a decaying path, shape (taps,)."""
    return white(taps, seed) * 10 ** (-3 * np.arange(taps) / taps)


def test_a_known_path_is_found_and_taken_out() -> None:
    played, path = white(4 * TAPS), room(TAPS)
    microphone = np.convolve(played, path)[: played.size]
    taps = leak(microphone, played)
    # The solver stops at a residual of 1e-4 of the equations, and their condition is ((1 + r) / (1 - r))^2 with r^2 of
    # taps over samples, 1/3 (Marchenko and Pastur).
    bound = 1e-4 * ((1 + 3**-0.5) / (1 - 3**-0.5)) ** 2
    assert np.linalg.norm(taps - path) < bound * np.linalg.norm(path)
    left = cancelled(microphone, played, taps)[TAPS:]
    assert np.std(left) < bound * np.std(microphone)


def test_the_masker_itself_is_taken_out() -> None:
    played = noise(colour="pink", samples=40_000, rate_hz=16_000, rng=np.random.default_rng(2))
    microphone = np.convolve(played, room(1600))[: played.size]
    taps = leak(microphone[:30_000], played[:30_000])
    assert np.std(cancelled(microphone, played, taps)[30_000:]) < 1e-3 * np.std(microphone)


def test_it_is_the_least_squares_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    """`numpy.linalg.lstsq` of the same equations, with the ridge as rows of their own."""
    monkeypatch.setattr(hearing, "TAPS", 40)
    monkeypatch.setattr(hearing, "SHORTEST", 120)
    monkeypatch.setattr(hearing, "_SOLVED", 1e-10)
    played = np.cumsum(white(400)) * 0.1 + white(400, 3)
    microphone = np.convolve(played, room(60))[:400] + 0.3 * white(400, 4)
    rows = np.stack([played[39 - k : 400 - k] for k in range(40)], axis=1)
    # The power that the ridge is a part of: of all samples, as in the first value of the autocorrelation.
    ridge = np.sqrt(1e-6 * np.sum(played**2)) * np.eye(40)
    wanted, *_ = np.linalg.lstsq(np.vstack([rows, ridge]), np.append(microphone[39:], np.zeros(40)), rcond=None)
    found = hearing.leak(microphone, played)
    assert np.linalg.norm(found - wanted) < 1e-7 * np.linalg.norm(wanted)


def test_noise_in_the_microphone_is_estimated_no_worse_than_least_squares_must() -> None:
    """Of white noise of power s over n equations L taps leave s L / n, in the mean: textbook of linear regression."""
    played, path, n = white(30_000, 5), room(800), 30_000 - TAPS
    microphone = np.convolve(played, path)[: played.size] + white(played.size, 6)
    taps = leak(microphone, played)
    error = np.sum((taps - np.pad(path, (0, TAPS - path.size))) ** 2)
    assert error == pytest.approx(TAPS / (n - TAPS), rel=0.2)


def test_samples_that_are_not_counted_do_not_matter() -> None:
    played, path = white(8 * TAPS), room(TAPS)
    microphone = np.convolve(played, path)[: played.size]
    counted = np.ones(played.size, np.bool_)
    counted[3 * TAPS : 5 * TAPS] = False
    spoken = microphone + np.where(counted, 0.0, 100 * white(played.size, 8))
    assert np.array_equal(leak(spoken, played, counted), leak(microphone, played, counted))
    assert np.linalg.norm(leak(spoken, played, counted) - path) < 1e-3 * np.linalg.norm(path)
    assert np.linalg.norm(leak(spoken, played) - path) > 1e-1 * np.linalg.norm(path)


def test_silence_of_the_masker_and_of_the_microphone() -> None:
    assert not leak(white(SHORTEST), np.zeros(SHORTEST)).any()
    assert not leak(np.zeros(SHORTEST), white(SHORTEST)).any()
    assert np.array_equal(cancelled(white(9), np.zeros(9), np.zeros(TAPS)), white(9))


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_scales_do_not_matter(scale: float) -> None:
    played, microphone = white(SHORTEST), white(SHORTEST, 7)
    assert leak(scale * microphone, played) == pytest.approx(
        scale * leak(microphone, played), rel=1e-6, abs=1e-9 * scale
    )
    assert leak(microphone, scale * played) == pytest.approx(
        leak(microphone, played) / scale, rel=1e-6, abs=1e-9 / scale
    )


@pytest.mark.parametrize("kind", ["constant", "one tone", "one sample", "clipped"])
def test_extreme_maskers_leave_finite_filters_that_do_not_add(kind: str) -> None:
    n = 4 * TAPS
    played = {
        "constant": np.ones(n),
        "one tone": np.sin(0.1 * np.arange(n)),
        "one sample": np.eye(1, n, 3000)[0],
        "clipped": np.clip(10 * white(n), -1, 1),
    }[kind]
    microphone = np.clip(np.convolve(played, room(500))[:n], -0.5, 0.5)
    taps = leak(microphone, played)
    assert np.all(np.isfinite(taps))
    left = cancelled(microphone, played, taps)[TAPS:]
    assert np.sum(left**2) <= 1.001 * np.sum(microphone[TAPS:] ** 2)


@pytest.mark.parametrize("shapes", [(SHORTEST - 1, SHORTEST - 1), (SHORTEST, SHORTEST + 1), (0, 0)])
def test_too_few_or_unlike_samples_are_refused(shapes: tuple[int, int], refuses: Refuses) -> None:
    with refuses(VoiceError):
        leak(np.ones(shapes[0]), np.ones(shapes[1]))
