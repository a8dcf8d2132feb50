"""Rig files: which devices stand in this laboratory, at which ports, with which calibration.

A reading becomes a height by straight lines between the calibrated points, and stands for the nearest one beyond them.
So `check` asks for points so far beyond gate and panel, and zeroing, that a reading at either end decides no crossing
and no contact, and that the noise of a resting foot stays inside.
"""

import hashlib
from collections.abc import Iterator, Mapping
from datetime import date
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar, cast

import rfc8785
from pydantic import Field, PrivateAttr

from palpate.experiment import storage
from palpate.experiment.apparatus.display import ButtonsRig, PedalRig, ScreenRig
from palpate.experiment.apparatus.servo.settings import ServoRig
from palpate.experiment.apparatus.tracker.settings import TrackerRig
from palpate.experiment.apparatus.wires.settings import LSL, TriggerRig
from palpate.experiment.errors import ProtocolError, Remedy, RigError
from palpate.experiment.protocol.kinds import list_at, table_at, tables_at
from palpate.experiment.protocol.models import Step
from palpate.experiment.settings import load as files
from palpate.experiment.settings.load import ONE_LINE, Broken, Confined, Line, Name, Rules, driver_key, port_rules

Table = TypeVar("Table", bound=Confined)

REHEARSAL = "rehearsal"
"""Stands for a port or an address that `palpate rehearse` fills in; only simulated rigs may say it."""

PLACES = dict.fromkeys(("actuator", "accelerometer", "servo"), "address") | {"audio": "device"}
PLACES |= {"tracker": "port", "pedal": "port", "buttons": "port"}
"""Where each device of a rig is found, by its table: the key that a simulated rig leaves to the rehearsal."""


def _actuator_rules(table: Any) -> Iterator[Broken]:
    """The driver `audio` has no `address`; the others need one.

    Your own driver needs `output_v` or `output_m_s2`, except with `shaping`. Exactly one of `full_scale_m_s2` and the
    `shaping` table is required. With `full_scale_m_s2`, set both `low_hz` and `high_hz` or neither; `high_hz` is
    greater. `inverse_ahead_ms` needs the `measured` table.
    """
    yield from port_rules(table)
    sound, address = table.get("driver") == "audio", table.get("address")
    if not sound and address is None:
        yield Broken(("address",), "host:port of its server, such as 127.0.0.1:4711, or an address for your own driver")
    elif sound and address is not None:
        yield Broken(("address",), "no address with driver 'audio': [audio] names the device")
    outputs = [table[key] for key in ("output_v", "output_m_s2") if table.get(key) is not None]
    if len(outputs) != (":" in str(table.get("driver")) and table.get("shaping") is None):
        yield Broken(("output_v",), "output_v or output_m_s2 with your own driver, unless there is [actuator.shaping]")
    takes = [key for key in ("full_scale_m_s2", "shaping") if table.get(key) is not None]
    if len(takes) != 1:
        either = "this key if the device takes accelerations, the [actuator.shaping] table if it takes volts"
        yield Broken(("full_scale_m_s2",), f"{either}; exactly one of them")
    if table.get("inverse_ahead_ms") is not None and table.get("measured") is None:
        yield Broken(
            ("inverse_ahead_ms",), "this key only with [actuator.measured], which `palpate calibrate actuator` writes"
        )
    low, high = table.get("low_hz"), table.get("high_hz")
    if (low, high) != (None, None) and table.get("shaping") is not None:
        yield Broken(("low_hz",), "no low_hz or high_hz with [actuator.shaping]: its response table states the band")
    elif (low is None) != (high is None):
        yield Broken(("low_hz",), "both low_hz and high_hz, or neither")
    elif isinstance(low, int | float) and isinstance(high, int | float) and high <= low:
        yield Broken(("high_hz",), f"a number greater than low_hz ({low})")


TableName = Annotated[
    str,
    Field(pattern=r"^[^/\\\s]+\.csv$", description="the name of a .csv file in the folder of the rig file"),
    ONE_LINE,
]
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$", description="64 hexadecimal digits, as sha256sum prints them")]
Days = Annotated[int, Field(ge=1, le=3650)]


class ShapingRig(Confined):
    """The response of a device in volts (Okamoto et al., equation (7)).

    Attributes:
        response: measured response.
        response_sha256: its hash.
        full_scale_v: voltage of a sample of 1.0; the final limit.
        gain_limit_v_per_m_s2: limit of each bin, near nulls of the response.
    """

    response: TableName
    response_sha256: Digest
    full_scale_v: Annotated[float, Field(gt=0, le=1000)]
    gain_limit_v_per_m_s2: Annotated[float, Field(gt=0, le=1000)]


class MeasuredRig(Confined):
    """The panel as `palpate calibrate actuator` measured it.

    Attributes:
        response: complex response to a sample of 1.0.
        response_sha256: its hash.
        load: what was on the panel.
        full_scale_m_s2: mean of the usable band, small drive.
        low_hz: start of the usable band (within 3 dB of its middle).
        high_hz: end of the usable band.
        resonances_hz: peaks.
        loudest: highest sample played.
        check_peak: highest sample of the check before each session.
        compression_db: loss of level at `loudest`.
        accelerometer_m_s2: `accelerometer.full_scale_m_s2` at that time.
        accelerometer_calibrated_on: date of its calibration.
        calibrated_on: date.
        calibration_days: validity period.
        output: output for a sample of 1.0, in V or m/s^2.
        accelerometer_v: `accelerometer.full_scale_v` at that time.
        driver_sha256: hash of the driver's file.
        accelerometer_driver_sha256: hash of the accelerometer driver's file.
    """

    response: TableName
    response_sha256: Digest
    load: Line
    full_scale_m_s2: Annotated[float, Field(gt=0)]
    low_hz: Annotated[float, Field(gt=0)]
    high_hz: Annotated[float, Field(gt=0)]
    resonances_hz: tuple[Annotated[float, Field(gt=0)], ...]
    loudest: Annotated[float, Field(gt=0, le=1)]
    check_peak: Annotated[float, Field(gt=0, le=1)]
    compression_db: float
    accelerometer_m_s2: Annotated[float, Field(gt=0)]
    accelerometer_calibrated_on: date | None = None
    calibrated_on: date
    calibration_days: Days
    output: Annotated[float, Field(gt=0)] | None = Field(None, json_schema_extra={"since": 6})
    accelerometer_v: Annotated[float, Field(gt=0)] | None = Field(None, json_schema_extra={"since": 6})
    driver_sha256: Digest | None = Field(None, json_schema_extra={"since": 6})
    accelerometer_driver_sha256: Digest | None = Field(None, json_schema_extra={"since": 6})


class ActuatorRig(Confined):
    """The device that vibrates the panel.

    Attributes:
        driver: server of raw float32 samples, audio channel, or a class of a module as for the tracker.
        address: of the server, or for your own driver to open.
        rate_hz: sampling rate.
        full_scale_m_s2: acceleration of a sample of 1.0, if the device takes accelerations.
        low_hz: lowest measured frequency of such a device.
        high_hz: highest measured frequency; without both, losses are unknown.
        shaping: the measured response, for a device that takes volts.
        measured: the panel, as `palpate calibrate actuator` measured it.
        inverse_ahead_ms: use the inverse of the complex response instead of equation (7), starting this long before
            predicted contact.
        output_v: output for a sample of 1.0, for your own driver if it needs volts.
        output_m_s2: the same if it needs accelerations, whether or not the panel was measured.
    """

    RULES: ClassVar[Rules] = _actuator_rules

    driver: Annotated[str, driver_key("pcm-tcp", "audio"), ONE_LINE]
    address: Line | None = None
    rate_hz: Annotated[int, Field(ge=1000, le=192_000)]
    full_scale_m_s2: Annotated[float, Field(gt=0, le=1000)] | None = None
    low_hz: Annotated[float, Field(ge=0)] | None = None
    high_hz: Annotated[float, Field(gt=0)] | None = None
    shaping: ShapingRig | None = None
    measured: MeasuredRig | None = Field(None, json_schema_extra={"since": 4})
    inverse_ahead_ms: Annotated[float, Field(ge=0, le=50)] | None = Field(None, json_schema_extra={"since": 6})
    output_v: Annotated[float, Field(gt=0, le=1000)] | None = Field(None, json_schema_extra={"since": 6})
    output_m_s2: Annotated[float, Field(gt=0, le=1000)] | None = Field(None, json_schema_extra={"since": 6})

    @property
    def full_scale(self) -> float:
        """The value of a sample of 1.0: V where there is `shaping`, else m/s^2."""
        if self.shaping is not None:
            return self.shaping.full_scale_v
        # The rules refuse a rig with neither.
        return cast("float", self.full_scale_m_s2)

    @property
    def output(self) -> float | None:
        """What a sample of 1.0 is to the device, V or m/s^2, where the rig file says so."""
        return self.shaping.full_scale_v if self.shaping is not None else self.output_v or self.output_m_s2

    @property
    def carries_hz(self) -> tuple[float, float] | None:
        """The band of a device that takes accelerations, Hz; None where nobody measured it."""
        return None if self.low_hz is None or self.high_hz is None else (self.low_hz, self.high_hz)


def _accelerometer_rules(table: Any) -> Iterator[Broken]:
    """`trigger_m_s2` is less than `full_scale_m_s2`; `full_scale_v` is only for your own driver."""
    yield from port_rules(table)
    full_scale, trigger = table.get("full_scale_m_s2"), table.get("trigger_m_s2")
    if isinstance(full_scale, int | float) and isinstance(trigger, int | float) and trigger >= full_scale:
        yield Broken(("trigger_m_s2",), f"less than full_scale_m_s2 ({full_scale})")
    if table.get("full_scale_v") is not None and ":" not in str(table.get("driver")):
        yield Broken(("full_scale_v",), "this key only with your own driver")


class AccelerometerRig(Confined):
    """The sensor that measures the panel.

    Attributes:
        driver: server of an endless stream of raw float32 samples, or a class of a module as for the tracker.
        address: of the server, or for your own driver to open.
        rate_hz: rate of the protocol's recordings.
        full_scale_m_s2: acceleration of a sample of 1.0.
        trigger_m_s2: a take begins at this level, above the noise at rest.
        stays: false if it is removed from the panel: sessions then do not use it, and the measurement is valid for
            30 days at most.
        calibrated_on: calibration date of `full_scale_m_s2`; a real rig needs it to calibrate the actuator.
        full_scale_v: voltage at `full_scale_m_s2`, for your own driver if it reads volts.
    """

    RULES: ClassVar[Rules] = _accelerometer_rules

    driver: Annotated[str, driver_key("pcm-tcp"), ONE_LINE]
    address: Line
    rate_hz: Annotated[int, Field(ge=100, le=192_000)]
    full_scale_m_s2: Annotated[float, Field(gt=0, le=10_000)]
    trigger_m_s2: Annotated[float, Field(gt=0)]
    stays: bool | None = Field(None, json_schema_extra={"since": 4})
    calibrated_on: date | None = Field(None, json_schema_extra={"since": 4})
    full_scale_v: Annotated[float, Field(gt=0, le=1000)] | None = Field(None, json_schema_extra={"since": 6})


def response_table(folder: Path, shaping: ShapingRig | MeasuredRig) -> bytes:
    """Return the response table in a folder. Raises `RigError` if it is unreadable or not of the rig file's hash."""
    path = folder / shaping.response
    try:
        content = storage.read_bytes(path)
    except OSError as error:
        allowed = "the response table of the rig file"
        raise RigError(path, f"cannot be read ({error.strerror})", "restore it", allowed=allowed) from error
    digest = hashlib.sha256(content).hexdigest()
    if digest != shaping.response_sha256:
        remedy = "restore the table, or measure again and write the new sha256 into the rig file"
        allowed = f"{shaping.response_sha256}, as in the rig file"
        raise RigError(path, f"got a table with sha256 {digest}", remedy, allowed=allowed)
    return content


Channel = Annotated[int, Field(ge=1, le=256, description="a channel, counted from 1 as on the device")]


def _channel_rules(table: Any) -> Iterator[Broken]:
    """No two outputs, and no two inputs, share a channel."""
    headphones, actuator = table.get("headphones"), table.get("actuator")
    if isinstance(headphones, list | tuple):
        if len(set(map(str, headphones))) < len(headphones):
            yield Broken(("headphones",), "each channel once")
        if actuator in headphones:
            yield Broken(("actuator",), "a separate channel: the headphones use this one")
    if table.get("microphone") is not None and table.get("microphone") == table.get("loopback"):
        yield Broken(("loopback",), "a separate channel: the microphone uses this one")


class AudioChannels(Confined):
    """Channels, counted from 1.

    Attributes:
        headphones: outputs for the masker, at most 8.
        actuator: output for the stimulus.
        microphone: input for the participant's voice.
        loopback: input for the signal sent to the actuator's amplifier.
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

    def without_actuator(self, *, listens: bool) -> tuple[int, int]:
        """Return how many outputs and inputs to open for a masker alone, and for a microphone that `listens`.

        Channels open from the first on: an actuator below the last of the headphones stays open, and silent.
        """
        return max(self.headphones), self.microphone or 0 if listens else 0


class HeadphonesRig(Confined):
    """Level at the ear: play pink noise, measure its level, and add how far its rms was below full scale.

    Attributes:
        full_scale_db_a: level of pink noise with its rms at full scale.
        calibrated_on: date.
        calibration_days: validity period.
    """

    full_scale_db_a: Annotated[float, Field(ge=40, le=160)]
    calibrated_on: date
    calibration_days: Days


class LatencyRig(Confined):
    """Delay, as `palpate calibrate audio` measures it. Only their sum is measured; the driver divides it.

    Attributes:
        output_ms: from taking a frame to the output.
        input_ms: from input to delivery.
        loopback_gain: recorded value of a sample of 1.0.
        calibrated_on: date.
        calibration_days: validity period.
    """

    output_ms: Annotated[float, Field(ge=0, le=1000)]
    input_ms: Annotated[float, Field(ge=0, le=1000)]
    loopback_gain: Annotated[float, Field(gt=0, le=1000)]
    calibrated_on: date
    calibration_days: Days


class DeliveredRig(Confined):
    """How far a delivered stimulus may differ from the intended one.

    Attributes:
        onset_ms: early or late, relative to the requested time.
        contact_ms: early or late, relative to contact.
        gain_db: louder or softer.
        residual_db: unexplained power, relative to the waveform; for silence the loudest sample, relative to full
            scale.
    """

    onset_ms: Annotated[float, Field(gt=0, le=100)]
    contact_ms: Annotated[float, Field(gt=0, le=100)] | None = None
    gain_db: Annotated[float, Field(gt=0, le=20)]
    residual_db: Annotated[float, Field(ge=-200, lt=0)]


class AudioRig(Confined):
    """Masker, stimulus, microphone and loopback on one device and clock.

    Attributes:
        host_api: see `palpate devices`.
        device: see `palpate devices`.
        rate_hz: sampling rate.
        block: frames per period; with JACK the server's.
        channels: which channel is what.
        headphones: how loud the headphones are.
        latency: how late the device is.
        delivered: what counts as delivered.
    """

    host_api: Line
    device: Line
    rate_hz: Annotated[int, Field(ge=8000, le=192_000)]
    block: Annotated[int, Field(ge=16, le=8192)]
    channels: AudioChannels
    headphones: HeadphonesRig
    latency: LatencyRig
    delivered: DeliveredRig


def _site_rules(table: Any) -> Iterator[Broken]:
    """`channel` only and always with `actuator.driver = "audio"`; `loopback` needs it, and the table `latency`."""
    actuator = table.get("actuator")
    if isinstance(actuator, dict) and (actuator.get("driver") == "audio") != (table.get("channel") is not None):
        yield Broken(("channel",), "an output with actuator.driver 'audio', otherwise no such key")
    if (table.get("loopback") is None) != (table.get("latency") is None):
        yield Broken(("loopback",), "both loopback and the table [sites.latency], or neither")
    elif table.get("loopback") is not None and table.get("channel") is None:
        yield Broken(("loopback",), "no loopback without channel")


class SiteRig(Confined):
    """One of several actuators, each at a site of the body.

    Attributes:
        name: of the site, as in the protocol.
        channel: output of the audio device.
        loopback: input for the signal sent to this actuator's amplifier.
        latency: of this output and input, as `palpate calibrate audio --site` measures it.
        actuator: the device.
    """

    RULES: ClassVar[Rules] = _site_rules

    name: Name
    channel: Channel | None = None
    loopback: Channel | None = None
    latency: LatencyRig | None = None
    actuator: ActuatorRig


CALIBRATE_AUDIO = ("palpate", "calibrate", "audio", "--rig", "RIG")


def at_site(command: tuple[str, ...], site: str | None) -> tuple[str, ...]:
    """Return a command that calibrates a device, for that of a site if there are several."""
    return command if site is None else (*command, "--site", site)


DOCTOR = ("palpate", "doctor", "--rig", "RIG")

UNCALIBRATED = date(2000, 1, 1)
"""What a rig file that `palpate new --rig` wrote has in place of each date of a calibration."""


def check_age(calibrated: LatencyRig | HeadphonesRig, today: date, site: str | None = None) -> None:
    """Refuse, with a `RigError`, what was calibrated too long ago, or after today; a latency may be that of a site."""
    table, after = "audio.headphones", ", and put the result into the rig file"
    remedy: Remedy | str = f"measure the headphones' level again{after}"
    if isinstance(calibrated, LatencyRig):
        table = "audio.latency" if site is None else f"sites.latency of {site}"
        remedy = Remedy(f"run {{}}{after}", at_site(CALIBRATE_AUDIO, site), suffices=False)
    made, days = calibrated.calibrated_on, calibrated.calibration_days
    age = (today - made).days
    got, allowed = f"a calibration from {made}, {age} days old on {today}", f"0 to {days} days"
    if made == UNCALIBRATED:
        got, allowed = f"{made}, the placeholder date of an uncalibrated rig file", "the date of a calibration"
    elif 0 <= age <= days:
        return
    raise RigError(table, f"got {got}", remedy, allowed=allowed)


ABOVE_GATE_MM, BELOW_CONTACT_MM = 5.0, 1.0
"""How far above the gate, and below contact, the calibration must reach, mm: a fast foot moves less in several samples,
and the sole gives way."""


NO_ACTUATOR = (
    "an [actuator] table, which every rig needs; to calibrate a tracker without one, put this line above the tables: "
    'actuator = { driver = "pcm-tcp", address = "127.0.0.1:4711", rate_hz = 5000, full_scale_m_s2 = 1 }'
)
"""What a file without an actuator needs."""


def _rig_rules(table: Any) -> Iterator[Broken]:
    """`actuator.driver = "audio"` needs the `[audio]` table, with the same `rate_hz`.

    `[servo]` needs `[tracker]`, without `tracker.force`; formats before 5 always need `[tracker]`.

    At most one of `[[triggers]]` has `driver = "lsl"`. `[[sites]]` differ in names and channels, with the driver and
    `rate_hz` of `[actuator]`, and `accelerometer.stays` is false.

    Only a simulated rig may have "rehearsal" as a port, address or device.
    """
    if table.get("actuator") is None:
        yield Broken(("actuator",), NO_ACTUATOR)
    yield from _audio_rules(table.get("actuator"), table.get("audio"))
    if table.get("tracker") is None:
        if table.get("servo") is not None:
            yield Broken(("tracker",), "a [tracker] table, to follow the hand that [servo] pushes")
        elif table.get("format") in (1, 2, 3, 4):
            yield Broken(("tracker",), "a [tracker] table; only format = 5 or later may omit it")
    if table.get("servo") is not None and isinstance(tracker := table.get("tracker"), dict) and tracker.get("force"):
        yield Broken(
            ("tracker", "force"), "no such table with [servo], because palpate records the force of a foot only"
        )
    lines = table.get("triggers")
    drivers = [one.get("driver") for one in lines if isinstance(one, dict)] if isinstance(lines, list | tuple) else []
    if drivers.count(LSL) > 1:
        yield Broken(("triggers",), f"at most one trigger line with driver '{LSL}'")
    yield from _sites_rules(table)
    rig = table.get("rig")
    if not isinstance(rig, dict) or rig.get("simulated") is not False:
        return
    for device, key in PLACES.items():
        settings = table.get(device)
        if isinstance(settings, dict) and settings.get(key) == REHEARSAL:
            yield Broken((device, key), f"a real {key}: '{REHEARSAL}' is for rigs with simulated = true")


def _audio_rules(actuator: Any, audio: Any) -> Iterator[Broken]:
    if not isinstance(actuator, dict) or actuator.get("driver") != "audio":
        return
    if audio is None:
        yield Broken(("audio",), "an [audio] table, because actuator.driver is 'audio'")
    elif isinstance(audio, dict) and audio.get("rate_hz") != actuator.get("rate_hz"):
        allowed = f"audio.rate_hz ({audio.get('rate_hz')}), because the actuator is an audio channel"
        yield Broken(("actuator", "rate_hz"), allowed)


def _sites_rules(table: Any) -> Iterator[Broken]:
    channels = table_at(table_at(table, "audio"), "channels")
    headphones, microphone = list_at(channels, "headphones"), channels.get("microphone")
    taken: dict[str, list[Any]] = {"name": [], "channel": [*headphones], "loopback": [microphone]}
    for i, site in tables_at(table, "sites"):
        for key, others in taken.items():
            if (value := site.get(key)) is not None and value in others:
                yield Broken(("sites", i, key), f"a {key} that nothing else has")
            others.append(value)
        for key in ("driver", "rate_hz"):
            own, first = table_at(site, "actuator").get(key), table_at(table, "actuator").get(key)
            if own != first:
                yield Broken(("sites", i, "actuator", key), f"actuator.{key} ({first})")
    sensor = table.get("accelerometer")
    if list_at(table, "sites") and isinstance(sensor, dict) and sensor.get("stays") is not False:
        yield Broken(("accelerometer", "stays"), "false, because one sensor cannot stay on several actuators")


class Identity(Confined):
    """The rig's name, and whether it is simulated.

    Attributes:
        name: of the rig.
        simulated: true for rehearsals, false for participants.
    """

    name: Name
    simulated: bool


Elsewhere = Annotated[
    str,
    Field(
        pattern=r"^(~/)?[^~\s]",
        description="a path, relative to the rig file's folder or, after ~/, to your home folder",
    ),
    ONE_LINE,
]


class AnchorsRig(Confined):
    """Where the end of each session is anchored outside the dataset.

    Attributes:
        file: the register, best on another disk or shared drive.
        key: private SSH key that signs anchors.
    """

    file: Elsewhere
    key: Elsewhere | None = None


class ContactorRig(Confined):
    """The part that touches the skin, for a paper's methods (ISO 13091-1 requires it for vibration thresholds).

    Attributes:
        part: the contactor, and the part of the body.
        area_mm2: contact area.
        gap_mm: from the contactor to its surround; omit if there is no surround.
        static_force_n: force of the skin on it, if the apparatus sets it.
    """

    part: Line
    area_mm2: Annotated[float, Field(gt=0)] | None = None
    gap_mm: Annotated[float, Field(ge=0)] | None = None
    static_force_n: Annotated[float, Field(ge=0)] | None = None


class StopsRig(Confined):
    """Stops outside palpate: software is not a safety function.

    Attributes:
        emergency: what cuts the power, and who can reach it.
        limit: what the amplifier cannot exceed, and why.
        tried_on: date on which both were tested.
        tried_days: validity period.
    """

    emergency: Line
    limit: Line
    tried_on: date
    tried_days: Days


def check_stops(rig: "Rig", limits_m_s2: Mapping[str | None, float], today: date) -> None:
    """Raise `RigError` for a real rig with unnamed or untested stops, for force or above the limit of a site.

    The participant's pedal has to be tried as well.
    """
    full_m_s2 = ((rig.at(site).actuator.full_scale_m_s2, limit) for site, limit in limits_m_s2.items())
    strong = any(full is None or full > limit for full, limit in full_m_s2)
    needed: list[tuple[str, StopsRig | PedalRig | None]] = [("stops", rig.stops)] if strong or rig.servo else []
    needed += [("pedal", rig.pedal)] if rig.pedal is not None else []
    for table, tried in needed if not rig.rig.simulated else ():
        got, allowed = "no [stops] table", "the emergency stop and the amplifier's own limit"
        if tried is not None:
            got, allowed = f"{table}.tried_on = {tried.tried_on}", f"0 to {tried.tried_days} days before {today}"
            if 0 <= (today - tried.tried_on).days <= tried.tried_days:
                continue
        remedy = (
            f"test {'it' if table == 'pedal' else 'both'}, and write the date into {table}.tried_on in the rig file"
        )
        raise RigError(f"rig '{rig.rig.name}'", f"got {got}", remedy, allowed=allowed)


class Rig(Confined):
    """A whole rig.

    Attributes:
        format: version of the file format.
        rig: what it is called.
        tracker: what follows the foot, where a kind of trial needs it.
        actuator: what shakes the panel.
        accelerometer: what measures the panel, for `palpate record` and `palpate calibrate actuator`.
        audio: the audio device, where there is one: for the masker, the loopback and an actuator with `driver =
            "audio"`.
        servo: what pushes the hand back, for a task with virtual surfaces; the tracker then follows the hand, and
            heights count from the face of the block.
        screen: the participant's screen, where there is one.
        anchors: where each session's end is anchored.
        stops: the emergency stop and the amplifier's own limit; a real rig needs them for a force device, and for an
            actuator that may exceed the board's limit.
        pedal: the participant's pedal or button that stops everything, where there is one.
        buttons: the participant's buttons for answers, where there are any.
        triggers: what tells other machines of events, by numbers; nothing is sent without it.
        contactor: what touches the skin, for the dataset and the methods of a paper.
        sites: actuators at sites of the body that a protocol names; `actuator` plays stimuli without a site.
    """

    RULES: ClassVar[Rules] = _rig_rules

    format: Literal[1, 2, 3, 4, 5, 6]
    rig: Identity
    tracker: TrackerRig | None = None
    actuator: ActuatorRig
    accelerometer: AccelerometerRig | None = None
    audio: AudioRig | None = None
    servo: ServoRig | None = None
    screen: ScreenRig | None = None
    anchors: AnchorsRig | None = None
    stops: StopsRig | None = Field(None, json_schema_extra={"since": 2})
    pedal: PedalRig | None = Field(None, json_schema_extra={"since": 3})
    buttons: ButtonsRig | None = Field(None, json_schema_extra={"since": 6})
    triggers: tuple[TriggerRig, ...] | None = Field(None, json_schema_extra={"since": 6})
    contactor: ContactorRig | None = Field(None, json_schema_extra={"since": 6})
    sites: tuple[SiteRig, ...] | None = Field(None, json_schema_extra={"since": 6})

    _folder: Path | None = PrivateAttr(None)
    _site: str | None = PrivateAttr(None)

    @property
    def folder(self) -> Path | None:
        """The folder of its file; None for a rig that was read from none."""
        return self._folder

    def at(self, site: str | None) -> "Rig":
        """Return the rig with the actuator of a site as its only one, itself for None; `RigError` for an unknown site.

        A simulated rig without `[[sites]]` has every site, each like its actuator, unless that is an audio channel.
        """
        if site is None or (self.sites is None and self.rig.simulated and self.actuator.driver != "audio"):
            return self
        names = [one.name for one in self.sites or ()]
        if site not in names:
            where, allowed = f"rig '{self.rig.name}'", ", ".join(names) or "a rig file with [[sites]]"
            raise RigError(where, f"has no site '{site}'", "add it to [[sites]] in the rig file", allowed=allowed)
        own, audio = (self.sites or ())[names.index(site)], self.audio
        if audio is not None and own.channel is not None:
            ports = {"actuator": own.channel, "loopback": own.loopback}
            changed = {"channels": audio.channels.model_copy(update=ports), "latency": own.latency or audio.latency}
            audio = audio.model_copy(update=changed)
        view = self.model_copy(update={"actuator": own.actuator, "audio": audio, "sites": None})
        view._site = site
        return view

    @property
    def site(self) -> str | None:
        """The site of the body whose actuator `at` made the only one."""
        return self._site

    @property
    def views(self) -> "dict[str | None, Rig]":
        """The rig with its own actuator, then as each of its sites has it, by name."""
        return {None: self, **{one.name: self.at(one.name) for one in self.sites or ()}}

    @property
    def response_tables(self) -> tuple[ShapingRig | MeasuredRig, ...]:
        """What names a file beside the rig file: the responses of all actuators."""
        each = (table for one in self.views.values() for table in (one.actuator.shaping, one.actuator.measured))
        return tuple(table for table in each if table is not None)

    def driver_file(self, driver: str) -> Path | None:
        """Return the file beside the rig file that contains a driver `module:Class`; None where a package does."""
        module, own, _ = driver.partition(":")
        file = self._folder / f"{module}.py" if own and self._folder is not None else None
        return file if file is not None and file.is_file() else None

    def driver_sha256(self, table: ActuatorRig | AccelerometerRig) -> str | None:
        """Return the hash of what the driver of a table has, 64 hexadecimal digits; None without a file of its own."""
        file = self.driver_file(table.driver)
        return None if file is None else _driver_sha256(file)

    @property
    def driver_files(self) -> tuple[Path, ...]:
        """The files beside the rig file that contain a driver: the tracker's, then those of others."""
        actuators = (one.actuator for one in self.views.values())
        tables = self.tracker, *actuators, self.accelerometer, self.servo, *(self.triggers or ())
        drivers = [one.driver for one in tables if one is not None]
        return tuple(dict.fromkeys(filter(None, map(self.driver_file, drivers))))


def needed(rig: Rig, name: str, table: Table | None, remedy: Remedy | str, why: str) -> Table:
    """Return a table of a rig; `RigError` with what to do and why, if the rig has none."""
    if table is None:
        raise RigError(f"rig '{rig.rig.name}'", f"got no [{name}] table", remedy, allowed=f"one, {why}")
    return table


def tracker_of(rig: Rig) -> TrackerRig:
    """Return the settings of the rig's tracker; `RigError` if the rig has none."""
    remedy, why = (
        "use a rig file with a tracker, or add the table",
        "because palpate needs the position of the foot or the hand",
    )
    return needed(rig, "tracker", rig.tracker, remedy, why)


def load(path: Path) -> Rig:
    """Return a file's rig. Raises `RigError` with every problem, one a line, or the first in its syntax."""
    try:
        rig = files.read(path, Rig)
    except ProtocolError as error:
        raise RigError.saying(error) from error
    rig._folder = path.resolve().parent
    return rig


def session_rig(path: Path, digest: str) -> Rig:
    """Return the rig beside a session's journal, which has this digest. Raises `RigError`, also for another rig."""
    rig = load(path)
    if sha256(rig) != digest:
        names = ", ".join(file.name for file in rig.driver_files)
        beside = f" with its driver {names}" if names else ""
        raise RigError(
            path, f"is not the rig file{beside} that was used in the session", "restore the files from a backup"
        )
    return rig


def sha256(rig: Rig) -> str:
    """Return the SHA-256 of the RFC 8785 JSON of what the rig file states, 64 hexadecimal digits.

    A driver beside the file counts with its own hash; `RigError` if it is unreadable. Ports, addresses, anchors, stops,
    numbers of triggers, the participant's screen and pedal are omitted, since they measure nothing.
    """
    where: dict[str, Any] = {device: {key} for device, key in PLACES.items()}
    where["sites"] = {"__all__": {"actuator": where["actuator"]}}
    unmeasured = dict.fromkeys(("screen", "anchors", "stops", "pedal", "triggers"), True)
    stated = rig.model_dump(mode="json", exclude_none=True, exclude={**where, **unmeasured})
    own = rig.driver_file(rig.tracker.driver) if rig.tracker is not None else None
    if own is not None:
        stated["tracker"]["driver_sha256"] = _driver_sha256(own)
    if others := [file for file in rig.driver_files if file != own]:
        stated["drivers_sha256"] = {file.stem: _driver_sha256(file) for file in others}
    return hashlib.sha256(rfc8785.dumps(stated)).hexdigest()


def _driver_sha256(file: Path) -> str:
    try:
        return hashlib.sha256(storage.read_bytes(file)).hexdigest()
    except OSError as error:
        raise RigError(file, f"the driver cannot be read ({error.strerror})", "restore it") from error


def reach_mm(rig: Rig, step: Step) -> tuple[float, float]:
    """Return the lowest and highest height that a protocol needs calibrated, mm; zeroing moves heights either way."""
    moved_mm = tracker_of(rig).zeroing_mm or 0.0
    return step.contact_mm - BELOW_CONTACT_MM - moved_mm, step.gate_top_mm + ABOVE_GATE_MM + moved_mm


def check(rig: Rig, step: Step) -> None:
    """Refuse a calibration that does not reach past the gate and the panel of a protocol, with a `RigError`."""
    heights = [point.mm for point in tracker_of(rig).calibration]
    lowest, highest = reach_mm(rig, step)
    if min(heights) > lowest or max(heights) < highest:
        got = f"tracker.calibration covers {min(heights):g} to {max(heights):g} mm"
        needs = f"this protocol needs {lowest:g} to {highest:g} mm, because palpate never extrapolates"
        raise RigError(f"rig '{rig.rig.name}'", f"{got}; {needs}", "calibrate a wider range")
