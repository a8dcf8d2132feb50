"""SYNTHETIC speech by espeak-ng and flite, in a simulated room with the masker in it; it says nothing of people.

A voice says a text at a speed and a pitch. The room answers an impulse with the direct path and a tail of noise that
falls by 60 dB in `ROOM_S`. What headphones leak reaches the microphone by another path of the same room. Ambient noise
is there always. Whatever is drawn comes from a seed, and both synthesisers give the same samples on every run.

**True onset** is the first sample of the clean speech that is over `RISEN` of its peak, and the time of the direct
path. `RISEN` is the smallest round fraction that the silence before the words is below in every voice of flite, whose
own noise reaches 1.1 % of the peak; espeak-ng is silent there.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from palpate.experiment.synthesis.signals.noise import noise

RATE_HZ = 48_000
RISEN = 0.02
ROOM_S = 0.12
"""Reverberation time of the room: the tail falls by 60 dB in it, s."""

DIRECT_S = 0.0015
"""From mouth to microphone, half a metre, s."""

LEAKED_S = 0.012
"""From the masker's sample in the stream to the microphone's, latency of the device included, s."""

DIRECT_OVER_TAIL_DB = 3.0
AMBIENT_DB = -35.0
"""Ambient noise below the speech, both from 200 Hz to 6 kHz, dB."""

ANSWERABLE_S = 4.0
"""When an answer may begin, s after the beginning of a recording."""

SPEEDS = (0.8, 1.0, 1.25)
"""Of tested answers; 1 is the synthesiser's own."""

ENROLLED = ((0.9, 0.97), (1.1, 1.03))
"""Speed and pitch of the two takes of an answer: none is tested."""


@dataclass(frozen=True)
class Voice:
    """A voice of a synthesiser: its program, its name there, the language and the sex that it is said to have."""

    program: str
    name: str
    language: str
    sex: str

    def __str__(self) -> str:
        return f"{self.program} {self.name}"


TESTED = (
    *(Voice("espeak-ng", f"en-{name}", "en", name[-2]) for name in ("us+m1", "us+f2", "gb+f4", "gb+m7")),
    *(Voice("espeak-ng", f"ja+{name}", "ja", name[0]) for name in ("m2", "f1", "f3", "m6")),
    *(Voice("flite", name, "en", sex) for name, sex in (("slt", "f"), ("awb", "m"), ("kal16", "m"))),
)
"""Voices that figures are measured with."""

TRIED = (
    *(Voice("espeak-ng", f"en-{name}", "en", name[-2]) for name in ("us+m3", "us+f1", "gb-scotland+f5", "gb-x-rp+m5")),
    *(Voice("espeak-ng", f"ja+{name}", "ja", name[0]) for name in ("m4", "f5", "m8", "f2")),
    *(Voice("flite", name, "en", "m") for name in ("rms", "kal")),
)
"""Voices that thresholds were set with."""

ANSWERS = {
    "en": ("copy paper", "aluminum foil", "polypropylene", "typing paper"),
    "ja": ("こぴーようし", "あるみはく", "ぽりぷろぴれん", "たいぷようし"),
}
"""Those of the study that comes with palpate, in each language."""

NO_ANSWERS = {
    "en": (
        *("yes", "again please", "I don't know", "plastic bag", "newspaper", "what was that"),
        *("cardboard", "wait a moment", "sandpaper", "leather", "polyester", "coffee"),
    ),
    "ja": (
        *("はい", "もういちど", "わかりません", "しんぶんし", "だんぼーる", "ちょっとまって"),
        *("ぷらすちっく", "なんですか", "こーひー", "かわ", "ぽりえすてる", "つぎ"),
    ),
}


SHORT_ANSWERS = {"en": ("paper", "foil", "film", "sand", "snow")}
LIKE_SHORT = {"en": ("fail", "show", "sent", "pepper", "fill")}
"""Answers that are harder to tell, and words that sound like them."""


def missing() -> list[str]:
    """Return which of the two programs this machine lacks."""
    return [program for program in ("espeak-ng", "flite") if shutil.which(program) is None]


@cache
def say(voice: Voice, text: str, speed: float = 1.0, pitch: float = 1.0) -> NDArray[np.float64]:
    """Return a text said at a speed and a pitch, 1 being the voice's own, peak 1, shape (n,), at `RATE_HZ`."""
    if voice.program == "espeak-ng":
        done = subprocess.run(
            [
                "espeak-ng",
                "-v",
                voice.name,
                "-s",
                str(round(175 * speed)),
                "-p",
                str(round(50 * pitch)),
                "--stdout",
                text,
            ],
            capture_output=True,
            check=True,
        )
        heard = done.stdout
    else:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "said.wav"
            stretch, mean_hz = f"duration_stretch={1 / speed:.4f}", f"int_f0_target_mean={105 * pitch:.2f}"
            subprocess.run(
                [
                    *("flite", "-voice", voice.name, "--setf", stretch, "--setf", mean_hz),
                    *("--setf", f"f0_shift={pitch:.4f}", "-t", text, "-o", str(file)),
                ],
                check=True,
            )
            heard = file.read_bytes()
    rate_hz, samples = _wav(heard)
    wave = signal.resample_poly(samples.astype(np.float64), RATE_HZ, rate_hz)
    return np.asarray(wave / np.max(np.abs(wave)))


def _wav(heard: bytes) -> tuple[int, NDArray[np.int16]]:
    """Return rate and samples; espeak-ng writes a header to a pipe before it knows how long the speech will be."""
    data = heard.index(b"data") + 8
    rate_hz = int.from_bytes(heard[24:28], "little")
    return rate_hz, np.frombuffer(heard[data : data + (len(heard) - data) // 2 * 2], "<i2")


def risen(clean: NDArray[np.float64]) -> int:
    """Return the first sample over `RISEN` of the peak."""
    return int(np.argmax(np.abs(clean) > RISEN * np.max(np.abs(clean))))


def path(rng: np.random.Generator, delay_s: float) -> NDArray[np.float64]:
    """Return an impulse response of the room, whose direct path is 1, shape (n,)."""
    tail = np.arange(int(1.5 * ROOM_S * RATE_HZ))
    late = rng.normal(size=tail.size) * 10 ** (-3 * tail / RATE_HZ / ROOM_S)
    late[: int(0.002 * RATE_HZ)] = 0.0
    response = late * 10 ** (-DIRECT_OVER_TAIL_DB / 20) / np.sqrt(np.sum(late**2))
    response[0] += 1.0
    return np.concatenate([np.zeros(round(delay_s * RATE_HZ)), response])


def in_band_rms(samples: NDArray[np.float64]) -> float:
    """Return the rms from 200 Hz to 6 kHz."""
    n = fft.next_fast_len(samples.size, real=True)
    power = np.abs(fft.rfft(samples, n)) ** 2
    f = np.arange(power.size) * RATE_HZ / n
    return float(np.sqrt(2 * np.sum(power[(f >= 200) & (f <= 6000)]) / n / samples.size))


@dataclass(frozen=True)
class Recording:
    """What the microphone heard and what the masker played, shape (n,) both, and the true onset, s."""

    microphone: NDArray[np.float32]
    played: NDArray[np.float32]
    onset_s: float


@cache
def _round(seed: int) -> NDArray[np.float64]:
    return noise(colour="pink", samples=10 * RATE_HZ, rate_hz=RATE_HZ, rng=np.random.default_rng(seed))


def pink(samples: int, *, seed: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return pink noise from somewhere in a round of ten seconds, shape (n,); a seed is one round."""
    made = _round(seed)
    return np.roll(made, int(rng.integers(made.size)))[:samples]


Disturbance = Callable[[NDArray[np.float64], int, np.random.Generator], NDArray[np.float64]]
"""From the microphone's samples, in which speech has an rms of 1, the sample of its onset, and a generator: others."""


def record(
    clean: NDArray[np.float64],
    *,
    snr_db: float | None,
    rng: np.random.Generator,
    after_s: tuple[float, float] = (0.2, 1.2),
    moved_db: float | None = None,
    ambient_db: float = AMBIENT_DB,
    disturbed: Disturbance | None = None,
) -> Recording:
    """Return a recording of speech, which begins so long after it may, and ends 0.5 s after the speech.

    The speech is that much louder than the masker's leak, both from 200 Hz to 6 kHz, the speech from its true onset
    to its end; `None` is no masker. Where somebody moves, the leak's path is another from when an answer may begin: by
    that much of the path, dB.
    """
    begins = round((ANSWERABLE_S + rng.uniform(*after_s)) * RATE_HZ) - risen(clean)
    speech = np.zeros(begins + clean.size + RATE_HZ // 2)
    speech[begins : begins + clean.size] = clean
    at_microphone = signal.fftconvolve(speech, path(rng, DIRECT_S))[: speech.size]
    onset = begins + risen(clean) + round(DIRECT_S * RATE_HZ)
    loud = in_band_rms(at_microphone[onset : begins + clean.size])
    ambient = pink(speech.size, seed=1, rng=rng)
    microphone = at_microphone / loud + ambient / in_band_rms(ambient) * 10 ** (ambient_db / 20)
    played = np.zeros(speech.size)
    if snr_db is not None:
        # It played before the recording began too.
        before = round(0.5 * RATE_HZ)
        whole = pink(before + speech.size, seed=0, rng=rng)
        leak = signal.fftconvolve(whole, path(rng, LEAKED_S))[before : before + speech.size]
        gain = 10 ** (-snr_db / 20) / in_band_rms(leak)
        if moved_db is not None:
            other = signal.fftconvolve(whole, path(rng, LEAKED_S))[before : before + speech.size]
            leak[round(ANSWERABLE_S * RATE_HZ) :] += 10 ** (moved_db / 20) * other[round(ANSWERABLE_S * RATE_HZ) :]
        microphone += gain * leak
        played = whole[before:]
    if disturbed is not None:
        microphone = disturbed(microphone, onset, rng)
    return Recording((0.05 * microphone).astype(np.float32), (0.1 * played).astype(np.float32), onset / RATE_HZ)


def _burst(
    microphone: NDArray[np.float64], at: int, rng: np.random.Generator, *, lasts_s: float, low_hz: float, high_hz: float
) -> NDArray[np.float64]:
    """Return the samples with a burst of noise that falls by 60 dB while it lasts, and begins as loud as speech."""
    n = round(lasts_s * RATE_HZ)
    f = fft.rfftfreq(n, 1 / RATE_HZ)
    coloured = fft.irfft(fft.rfft(rng.normal(size=n)) * ((f >= low_hz) & (f <= high_hz)), n)
    wave = signal.fftconvolve(coloured / np.std(coloured) * 10 ** (-3 * np.arange(n) / n), path(rng, DIRECT_S))
    made = microphone.copy()
    made[at : at + wave.size] += wave[: microphone.size - at]
    return made


def coughed(microphone: NDArray[np.float64], onset: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the samples with a cough of two bursts that begins 0.8 s before the answer."""
    for before_s in (0.8, 0.6):
        at = onset - round(before_s * RATE_HZ)
        microphone = _burst(microphone, at, rng, lasts_s=0.25, low_hz=300, high_hz=5000)
    return microphone


def clicked(microphone: NDArray[np.float64], onset: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the samples with a click of the lips, 10 dB louder than speech, 0.15 s before the answer."""
    at = onset - round(0.15 * RATE_HZ)
    return _burst(microphone / 3, at, rng, lasts_s=0.01, low_hz=500, high_hz=8000) * 3


def stepped(microphone: NDArray[np.float64], onset: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the samples with a step's sound from when an answer may begin, as loud as speech, for half a second."""
    return _burst(microphone, round(ANSWERABLE_S * RATE_HZ), rng, lasts_s=0.5, low_hz=50, high_hz=1500)


def talked(microphone: NDArray[np.float64], onset: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the samples with words of somebody else two seconds before an answer may begin, as loud as the answer."""
    words = signal.fftconvolve(say(TRIED[0], "wait a moment"), path(rng, DIRECT_S))
    made, at = microphone.copy(), round((ANSWERABLE_S - 2) * RATE_HZ)
    made[at : at + words.size] += words / in_band_rms(words)
    return made


def hummed(microphone: NDArray[np.float64], onset: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the samples with mains hum of 50 Hz and its odd harmonics to 450 Hz, each half as strong, -10 dB."""
    t = np.arange(microphone.size) / RATE_HZ
    hum = np.sum([0.5**k * np.sin(2 * np.pi * 50 * (2 * k + 1) * t + k) for k in range(5)], axis=0)
    return np.asarray(microphone + hum / np.std(hum) * 10 ** (-10 / 20))


def clipped(microphone: NDArray[np.float64], onset: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the samples clipped at a third of their peak."""
    peak = np.max(np.abs(microphone)) / 3
    return np.clip(microphone, -peak, peak)
