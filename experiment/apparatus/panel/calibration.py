"""`palpate calibrate actuator`: plays multisines through a panel, hears them with its accelerometer, and judges both.

A measurement is refused where the sensor hears nothing of what is played, clips, runs at another rate, or leaves the
response too uncertain. The last is measured once more, for longer, before it is refused.
"""

import hashlib
import re
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from datetime import date
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import tomlkit
from numpy.typing import NDArray
from tomlkit.items import Table

from palpate.experiment import storage
from palpate.experiment.apparatus import host, opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.audio import calibration as probing
from palpate.experiment.apparatus.audio.stream import AudioStream
from palpate.experiment.apparatus.panel import accelerometer as accelerometers
from palpate.experiment.apparatus.panel import measured, multisine
from palpate.experiment.apparatus.panel.accelerometer import Window
from palpate.experiment.apparatus.panel.conditioning import Conditioner
from palpate.experiment.apparatus.panel.measured import Figures
from palpate.experiment.apparatus.panel.multisine import Estimate, Level
from palpate.experiment.apparatus.panel.pcm import PcmActuator
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.errors import RecordingError, RigError

LEVELS = (0.25, 0.5, 1.0, 1.0)
"""Peaks of the multisines, as parts of the loudest, which is played with two draws of phases."""

PERIODS, LONGER = 8, 32
"""Seconds of each level that count, at first and the second time."""

BEFORE_S, AFTER_S = 1, 0.5
"""What is played before them, until the panel's own ringing has died away, and after them, s."""

LATE_S = 0.5
"""How late the sensor's samples may come, s."""

LOW_HZ, HIGH_HZ = 10.0, 500.0
"""Where the response must be certain."""

UNCERTAIN_DB, MOST = 0.3, 0.95
"""The standard error of the level that this part of the lines may not exceed."""

UNHEARD = 0.5
"""With less coherence, in the middle of all lines, the sensor hears something else."""

DRIFT_PPM = 500.0
"""How far the clocks of player and sensor may differ."""


class Player(Protocol):
    """What shakes the panel by samples as they are, 1.0 being full scale."""

    def play(self, samples: NDArray[np.float32]) -> None:
        """Play them to their end."""


class Listener(Protocol):
    """What hears the panel."""

    def arm(self, samples: int) -> None:
        """Listen from now on for so many samples. Raises `RecordingError`."""

    def heard_since_armed(self) -> Window:
        """Return them once they have come. Raises `RecordingError`."""


class AudioPlayer:
    """Implements `Player` on an output channel, from 1, of an audio stream. The samples repeat each second."""

    def __init__(self, stream: AudioStream, channel: int) -> None:
        self._stream = stream
        self._channel = channel

    def play(self, samples: NDArray[np.float32]) -> None:
        loop = self._stream.play_loop(samples[: self._stream.rate_hz], (self._channel - 1,))
        loop.wanted = 1.0
        self._stream.wait(self._stream.next_frame + samples.size)
        loop.wanted = 0.0


@dataclass(frozen=True, eq=False)
class Calibration:
    """A panel as it was measured.

    Attributes:
        found: its response.
        figures: what that says.
        loudest: the highest sample played.
        seconds: of each level that counted.
    """

    found: Estimate
    figures: Figures
    loudest: float
    seconds: int

    @property
    def compression_db(self) -> float:
        """By how much less the panel moved at the loudest level than a small drive has it move, dB."""
        return -20 * float(np.log10(np.mean(self.found.gains[-2:])))

    @property
    def polarity(self) -> str:
        """Which way the panel moves, in words: by the sensor alone nobody can tell which of two is turned."""
        if abs(self.found.upright) < UNHEARD:
            return "the direction in which a positive sample moves the panel is unclear"
        if self.found.upright > 0:
            return "a positive sample moves the panel along the sensor's positive axis"
        turned = "the sensor is upside down, or the actuator's wires are swapped"
        return f"a positive sample moves the panel opposite to the sensor's positive axis: {turned}"


@dataclass(frozen=True)
class Devices:
    """What a calibration plays on and hears with, with their sampling rates, Hz."""

    player: Player
    listener: Listener
    played_hz: int
    heard_hz: int


@contextmanager
def devices(rig: Rig, *, loudest: float) -> Iterator[Devices]:
    """Yield the opened devices of a real rig; no sample exceeds `loudest`. Raises `PalpateError`."""
    settings, clock = accelerometers.settings_of(rig), MonotonicClock()
    with ExitStack() as opened:
        listener = opened.enter_context(closing(accelerometers.listener(rig, clock=clock)))
        player: Player
        full_scale = rig.actuator.full_scale
        condition = Conditioner(full_scale=full_scale, limit_m_s2=full_scale)
        if ":" in rig.actuator.driver:
            own = import_module("palpate.experiment.apparatus.wires.own.actuator")
            player = opened.enter_context(closing(own.DriverActuator(rig, condition, clock)))
        elif rig.actuator.address is not None:
            server = PcmActuator(rig.actuator.address, condition, rate_hz=rig.actuator.rate_hz, clock=clock)
            player = opened.enter_context(closing(server))
            server.reach()
        else:
            opened.enter_context(host.raised())
            stream = opened.enter_context(closing(probing.open_probing(rig, [rig], peak=loudest, clock=clock)))
            player = AudioPlayer(stream, opening.audio_of(rig).channels.actuator)
        yield Devices(player, listener, rig.actuator.rate_hz, settings.rate_hz)


def measure(on: Devices, *, loudest: float, seed: int) -> Calibration:
    """Return the panel's calibration, measured a second time for longer if its errors are too large.

    `loudest` is the highest sample played, and `seed` names the draws of phases. Raises `RecordingError` with the
    reason where there is none.
    """
    rng = np.random.default_rng(seed)
    for seconds in (PERIODS, LONGER):
        found = _estimated(on, loudest, seconds, rng)
        within = (found.lines_hz >= LOW_HZ) & (found.lines_hz <= HIGH_HZ)
        error_db = float(np.quantile(found.standard_error_db[within], MOST))
        if error_db <= UNCERTAIN_DB:
            clear = found.standard_error_db <= UNCERTAIN_DB
            return Calibration(found, measured.figures(found, clear), loudest, seconds)
    raise refusal(
        f"the response from {LOW_HZ:g} to {HIGH_HZ:g} Hz has a standard error of {error_db:.2f} dB",
        "find out what else shakes the panel, or raise --peak",
        allowed=f"{UNCERTAIN_DB:g} dB at {MOST:.0%} of the frequencies, after {LONGER} s at each level",
    )


def _estimated(on: Devices, loudest: float, seconds: int, rng: np.random.Generator) -> Estimate:
    """Play each level once, and return the response. Raises `RecordingError` for what is not of this panel."""
    lines_hz = multisine.lines(min(on.played_hz, on.heard_hz))
    levels = []
    for part in LEVELS:
        amplitudes = multisine.drawn(lines_hz, rate_hz=on.played_hz, rng=rng) * part * loudest
        levels.append(Level(amplitudes, heard(on, amplitudes, lines_hz, seconds)))
    within = (lines_hz >= LOW_HZ) & (lines_hz <= HIGH_HZ)
    found = multisine.estimate(levels, lines_hz, within)
    coherence = float(np.median(found.coherence[within]))
    if coherence < UNHEARD:
        raise unheard(coherence)
    if abs(found.drift_ppm) > DRIFT_PPM:
        raise refusal(
            f"the sensor's clock differs from the actuator's by {found.drift_ppm:.0f} ppm",
            "correct rate_hz in the rig file",
            allowed=f"{DRIFT_PPM:g} ppm",
        )
    return found


def unheard(coherence: float) -> RecordingError:
    """Return why a sensor is not that of the panel that played."""
    return refusal(
        f"the sensor does not detect the played signal (coherence {coherence:.2f})",
        "check that the actuator and the accelerometer in the rig file belong to the same panel and are switched on",
        allowed=f"{UNHEARD:g} or more",
    )


def refusal(what: str, remedy: str, allowed: str = "") -> RecordingError:
    """Return why a measurement of a panel does not count."""
    return RecordingError("panel calibration", what, f"{remedy}; then calibrate again", allowed=allowed)


TRIES = 3
"""How often a multisine is played at most: where samples were lost, its phases are known to a millisecond alone."""


def heard(
    on: Devices, amplitudes: NDArray[np.complex128], lines_hz: NDArray[np.int64], seconds: int
) -> NDArray[np.complex128]:
    """Play a multisine, and return what was heard of each line in each of so many seconds, m/s^2, shape (seconds, K).

    Raises `RecordingError` for a sensor that clips, is dead, or loses samples in each of `TRIES`.
    """
    played_hz, heard_hz, lasts_s = on.played_hz, on.heard_hz, BEFORE_S + seconds + AFTER_S
    second = multisine.period(amplitudes, lines_hz, rate_hz=played_hz).astype(np.float32)
    for _ in range(TRIES):
        on.listener.arm(round((lasts_s + LATE_S) * heard_hz))
        on.player.play(np.resize(second, round(lasts_s * played_hz)))
        window = on.listener.heard_since_armed()
        if window.clipped:
            raise refusal(f"{window.clipped} samples reached full scale", "lower --peak", allowed="none")
        begin = multisine.begins(window.samples_m_s2, round(lasts_s * heard_hz)) + BEFORE_S * heard_hz
        steady, begin_s = window.samples_m_s2[begin : begin + seconds * heard_hz], begin / heard_hz
        if not np.ptp(steady):
            what = "the sensor sends a constant value"
            raise refusal(what, "unplug and reconnect the sensor, or try another cable")
        lost = [gap for gap in window.gaps if begin_s - gap.lasts_s < gap.at_s < begin_s + seconds]
        if not lost:
            return multisine.spectra(steady, lines_hz, rate_hz=heard_hz)
    remedy = "close other programs on this computer, or correct accelerometer.rate_hz"
    raise refusal(lost[0].sentence, remedy, allowed=f"no loss in at least one of {TRIES} attempts")


def check_accelerometer(rig: Rig) -> None:
    """Raise `RigError` for a rig without an accelerometer, and a real one that does not say when it was calibrated."""
    if accelerometers.settings_of(rig).calibrated_on is None and not rig.rig.simulated:
        raise RigError(
            f"rig '{rig.rig.name}'",
            "got no accelerometer.calibrated_on",
            "write the date on its certificate into the rig file",
            allowed="the date on which accelerometer.full_scale_m_s2 was calibrated",
        )


def table_beside(out: Path, site: str | None) -> Path:
    """Return where the response of a new rig file is written, at a site of the body if there are several."""
    at = "" if site is None else f"-{re.sub(r'[^0-9A-Za-z]+', '-', site)}"
    return out.with_name(f"{out.stem}{at}-panel.csv")


def write(
    rig_file: Path, out: Path, made: Calibration, *, load: str, today: date, days: int, site: str | None = None
) -> None:
    """Write a new rig file with [actuator.measured], and beside it what the rig names. Raises `PalpateError`.

    With a `site` it is [sites.actuator.measured] of that one.
    """
    rig, text = rigs.load(rig_file).at(site), rig_file.read_text("utf-8-sig")
    settings, figures, found = accelerometers.settings_of(rig), made.figures, made.found
    remarks = (
        *(("SIMULATED: no panel was measured.",) if rig.rig.simulated else ()),
        f"Rig {rig.rig.name}, measured on {today} with {load} on the panel.",
        "Acceleration for a sample of 1.0 at a small drive, as estimated by palpate calibrate actuator.",
        "Delays have been removed, because the player and the sensor do not share a clock.",
        made.polarity.capitalize() + ".",
        f"The clocks differ by {found.drift_ppm:.2f} ppm. {made.seconds} s were evaluated at each level.",
    )
    table, content = table_beside(out, site), measured.table(found, remarks)
    dated = {} if settings.calibrated_on is None else {"accelerometer_calibrated_on": settings.calibrated_on}
    since_6 = {
        "output": rig.actuator.output,
        "accelerometer_v": settings.full_scale_v,
        "driver_sha256": rig.driver_sha256(rig.actuator),
        "accelerometer_driver_sha256": rig.driver_sha256(settings),
    }
    values = {
        "response": table.name,
        "response_sha256": hashlib.sha256(content).hexdigest(),
        "load": load,
        "full_scale_m_s2": _digits(figures.full_scale_m_s2),
        "low_hz": figures.low_hz,
        "high_hz": figures.high_hz,
        "resonances_hz": [_digits(one.hz) for one in figures.resonances],
        "loudest": made.loudest,
        "check_peak": made.loudest * LEVELS[0],
        "compression_db": round(made.compression_db, 3) + 0.0,
        "accelerometer_m_s2": settings.full_scale_m_s2,
        **dated,
        "calibrated_on": today,
        "calibration_days": days,
        **{key: value for key, value in since_6.items() if value is not None},
    }
    changed = rewritten(text, values, site)
    opening.copy_rig(rig_file, out)
    storage.write(table, content)
    storage.write(out, changed.encode())
    rigs.load(out)


SINCE_6 = {"output", "accelerometer_v", "driver_sha256", "accelerometer_driver_sha256"}
"""Keys of [actuator.measured] that a rig file of format 6 may have."""


def _digits(number: float) -> float:
    return float(f"{number:.5g}")


def rewritten(rig_text: str, found: dict[str, Any], site: str | None = None) -> str:
    """Return a rig file with [actuator.measured]; a device that takes accelerations also gets its full scale and band.

    With a `site` its actuator has them. Raises `RigError` if it has no table [actuator].
    """
    document = tomlkit.parse(rig_text)
    actuator = (document if site is None else probing.table_of(document, site)).get("actuator")
    if not isinstance(actuator, Table):
        raise RigError("actuator", "got no separate table", "write it as [actuator]", allowed="one")
    document["format"] = max(document.get("format", 1), 6 if SINCE_6 & found.keys() else 4)
    if "shaping" not in actuator:
        probing.unremarked(actuator.item("full_scale_m_s2"), "# NOT MEASURED")
        for key in ("full_scale_m_s2", "low_hz", "high_hz"):
            actuator[key] = found[key]
    inner = tomlkit.table()
    inner.update(found)
    actuator.pop("measured", None)
    actuator["measured"] = inner
    return tomlkit.dumps(document)


def report(made: Calibration) -> list[str]:
    """Return the results of a calibration line by line."""
    figures, found = made.figures, made.found
    gains = ", ".join(
        f"{20 * np.log10(gain):+.2f} dB at {part * made.loudest:g}"
        for part, gain in zip(LEVELS, found.gains, strict=True)
    )
    return [
        f"Full scale    {figures.full_scale_m_s2:.4g} m/s^2, standard error {figures.standard_error_m_s2:.2g}",
        f"Usable band   {figures.low_hz:g} to {figures.high_hz:g} Hz, within {measured.FLAT_DB / 2:g} dB",
        *(f"Resonance     {one.hz:.1f} Hz, standard error {one.standard_error_hz:.1g}" for one in figures.resonances),
        f"Gain          {gains}",
        f"Polarity      {made.polarity}",
        f"Clocks        differ by {found.drift_ppm:.1f} ppm; {made.seconds} s evaluated at each level",
    ]
