"""The audio device in a rig file: its channels, what was calibrated and when, and what counts as delivered."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import date
from typing import Annotated, Any, ClassVar

from pydantic import Field

from experiment.errors import RigError
from experiment.protocol.models import Confined, Text
from experiment.protocol.rules import Broken, Rules

Channel = Annotated[int, Field(ge=1, le=256, description="a channel, from 1 as on the device")]
Days = Annotated[int, Field(ge=1, le=3650)]


def _channel_rules(table: Any) -> Iterator[Broken]:
    headphones, actuator = table.get("headphones"), table.get("actuator")
    if isinstance(headphones, list | tuple):
        if len(set(map(str, headphones))) < len(headphones):
            yield Broken(("headphones",), "each channel once")
        if actuator in headphones:
            yield Broken(("actuator",), "a channel of its own: the headphones have this one")
    if table.get("microphone") is not None and table.get("microphone") == table.get("loopback"):
        yield Broken(("loopback",), "a channel of its own: the microphone has this one")


class AudioChannels(Confined):
    """Which channel of the device is what. `microphone` and `loopback` are inputs; the others outputs.

    `loopback` hears what the actuator's amplifier is given: a cable from its output, or a divider behind the amplifier.
    """

    RULES: ClassVar[Rules] = _channel_rules

    headphones: Annotated[tuple[Channel, ...], Field(min_length=1, max_length=8)]
    actuator: Channel
    microphone: Channel | None = None
    loopback: Channel | None = None

    @property
    def outputs(self) -> int:
        """Outputs to open."""
        return max(*self.headphones, self.actuator)

    @property
    def inputs(self) -> int:
        """Inputs to open."""
        return max(self.microphone or 1, self.loopback or 1)


class HeadphonesRig(Confined):
    """How loud the headphones are, as measured at the ear.

    `full_scale_db_a` is the level of pink noise whose rms is full scale (a sample of 1.0), in dB(A): play pink noise
    at a known lower level, measure, and add how far below full scale it was.
    """

    full_scale_db_a: Annotated[float, Field(ge=40, le=160)]
    calibrated_on: date
    calibration_days: Days


class LatencyRig(Confined):
    """How late the device is, as `palpate calibrate audio` measures it by loopback.

    A frame leaves the output `output_ms` after the stream took it, and what reaches an input is handed over `input_ms`
    later. Their sum is measured; how it divides is what the driver says. `loopback_gain` is what a sample of 1.0
    comes back as.
    """

    output_ms: Annotated[float, Field(ge=0, le=1000)]
    input_ms: Annotated[float, Field(ge=0, le=1000)]
    loopback_gain: Annotated[float, Field(gt=0, le=1000)]
    calibrated_on: date
    calibration_days: Days


class DeliveredRig(Confined):
    """What a stimulus heard by loopback may differ from the intended one and still count as delivered.

    `onset_ms`: how early or late, against when it was asked for; `contact_ms`: the same against contact, so that the
    error of the prediction counts, and not asked where it is left out; `gain_db`: how much louder or softer;
    `residual_db`: power of what neither delay nor gain explains, relative to the intended waveform; of an intended
    silence the loudest sample, relative to full scale.
    """

    onset_ms: Annotated[float, Field(gt=0, le=100)]
    contact_ms: Annotated[float, Field(gt=0, le=100)] | None = None
    gain_db: Annotated[float, Field(gt=0, le=20)]
    residual_db: Annotated[float, Field(ge=-200, lt=0)]


class AudioRig(Confined):
    """The one audio device of a session: masker, stimulus, microphone and loopback on one sample clock.

    `host_api` and `device` are as `palpate devices` lists them. `block` is the frames of a period; with JACK that of
    the server.
    """

    host_api: Text
    device: Text
    rate_hz: Annotated[int, Field(ge=8000, le=192_000)]
    block: Annotated[int, Field(ge=16, le=8192)]
    channels: AudioChannels
    headphones: HeadphonesRig
    latency: LatencyRig
    delivered: DeliveredRig


def check_calibrations(audio: AudioRig, today: date) -> None:
    """Refuse calibrations that are too old.

    Raises:
        RigError: a calibration is older than the rig allows, or was made after today.
    """
    check_latency(audio, today)
    check_headphones(audio, today)


def check_latency(audio: AudioRig, today: date) -> None:
    """The same for what `palpate calibrate audio` measures."""
    made, days = audio.latency.calibrated_on, audio.latency.calibration_days
    _check_age("latency", made, days, today, "run `palpate calibrate audio`")


def check_headphones(audio: AudioRig, today: date) -> None:
    """The same for the level of the headphones."""
    made, days = audio.headphones.calibrated_on, audio.headphones.calibration_days
    _check_age("headphones", made, days, today, "measure the headphones' level anew")


def _check_age(table: str, made: date, days: int, today: date, remedy: str) -> None:
    age = (today - made).days
    if not 0 <= age <= days:
        raise RigError(
            f"audio.{table}: got a calibration of {made}, {age} days old on {today}; allowed: 0 to {days} days; "
            f"{remedy}, and put the result into the rig file"
        )
