"""From a rig file to opened devices, whose drivers are imported only then."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import date
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, cast

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.ports import Actuator, Buttons, Pedal, Tracker
from palpate.experiment.apparatus.rig import REHEARSAL, AudioRig, Rig, needed, response_table, tracker_of
from palpate.experiment.apparatus.tracker.settings import FRAMES
from palpate.experiment.clock import Clock, MonotonicClock
from palpate.experiment.errors import ActuatorError, Finding, Remedy, RigError, TrackerError
from palpate.experiment.protocol.rules import Mode

if TYPE_CHECKING:
    from palpate.experiment.apparatus.audio.masker import MaskerNoise
    from palpate.experiment.apparatus.audio.stream import AudioStream, StreamSettings
    from palpate.experiment.apparatus.panel.conditioning import Drifted
    from palpate.experiment.apparatus.tracker.clock_map import ClockMap
    from palpate.experiment.synthesis.voltages import Drive


def audio_of(rig: Rig) -> AudioRig:
    """Return the settings of the rig's audio device; `RigError` if the rig has none."""
    remedy = Remedy("{} lists the devices of this computer", ("palpate", "devices"), suffices=False)
    return needed(rig, "audio", rig.audio, remedy, "because the masker and the loopback need it")


def open_audio(
    rig: Rig,
    *,
    limits_m_s2: Mapping[str | None, float],
    listens: bool,
    masker: MaskerNoise | None,
    clock: Clock,
    today: date,
    device: str | None = None,
) -> AudioStream:
    """Open what a session needs of the rig's audio device, as `session_stream` says; its clock must go by itself.

    A `device` replaces the rig's. Raises `RigError` if the rig has none, a real rig's calibration is too old `today`,
    or the device exists in simulation alone, and `AudioError` if it cannot be opened.
    """
    from palpate.experiment.apparatus.audio.stream import AudioStream

    audio = audio_of(rig)
    if device is None and audio.device == REHEARSAL:
        raise RigError.at(simulated_only(rig, "audio.device"))
    if not rig.rig.simulated:
        rigs.check_age(audio.latency, today)
        rigs.check_age(audio.headphones, today)
    settings = session_stream(rig, limits_m_s2=limits_m_s2, listens=listens, masker=masker)
    return AudioStream(replace(settings, device=device or audio.device), clock)


def session_stream(
    rig: Rig, *, limits_m_s2: Mapping[str | None, float], listens: bool, masker: MaskerNoise | None
) -> StreamSettings:
    """Return how a session opens its audio device, with a limit on every channel; all other channels stay silent.

    `limits_m_s2` are the protocol's at the sites of stimuli, the masker has its own. Without any, or with another
    actuator, output and loopback of the actuator stay closed, and inputs are kept only if a microphone `listens`. The
    slowest output decides when all end. Raises `RigError` without an audio device, or for a site that the rig lacks.
    """
    audio = audio_of(rig)
    channels, plays = audio.channels, bool(limits_m_s2) and rig.actuator.driver == "audio"
    outputs, inputs = open_channels(rig) if plays else channels.without_actuator(listens=listens)
    ceilings = [0.0] * outputs
    for channel in channels.headphones:
        ceilings[channel - 1] = masker.ceiling if masker is not None else 0.0
    output_ms = audio.latency.output_ms
    if plays:
        from palpate.experiment.apparatus.panel.conditioning import Conditioner

        for site, limit_m_s2 in limits_m_s2.items():
            own = rig.at(site)
            behind = own.actuator.shaping is not None or own.actuator.measured is not None
            conditioner = Conditioner(full_scale=own.actuator.full_scale, limit_m_s2=limit_m_s2)
            channel = audio_of(own).channels.actuator - 1
            ceilings[channel] = max(ceilings[channel], 1.0 if behind else conditioner.ceiling)
            output_ms = max(output_ms, audio_of(own).latency.output_ms)
    settings = stream_settings(
        audio, ceilings, inputs=inputs, sent=listens and channels.microphone is not None, stimuli=plays
    )
    return replace(settings, output_ms=output_ms)


def open_channels(rig: Rig) -> tuple[int, int]:
    """Return how many outputs and inputs the actuators of a rig need, its headphones and microphone included."""
    each = [audio_of(one).channels for one in rig.views.values()]
    return max(one.outputs for one in each), max(one.inputs for one in each)


def stream_settings(
    audio: AudioRig, ceilings: list[float], *, inputs: int, sent: bool, stimuli: bool
) -> StreamSettings:
    """Return how a stream is opened; `sent` has what leaves to the first of the headphones kept."""
    from palpate.experiment.apparatus.audio.stream import StreamSettings

    return StreamSettings(
        host_api=audio.host_api,
        device=audio.device,
        rate_hz=audio.rate_hz,
        block=audio.block,
        inputs=inputs,
        ceilings=tuple(ceilings),
        sent=audio.channels.headphones[0] - 1 if sent else None,
        stimuli=stimuli,
        output_ms=audio.latency.output_ms,
    )


def simulated_only(rig: Rig, key: str) -> Finding:
    """Return that a device exists in simulation alone and so cannot be opened; `key` names it in the rig file."""
    return Finding(
        f"rig '{rig.rig.name}' is simulated: its devices exist only inside `palpate rehearse`",
        remedy=f"use a rig file whose {key} names a real device",
    )


def copy_rig(rig_file: Path, copy: Path) -> None:
    """Copy a rig file with its response tables, and each driver that is a file beside it.

    Raises `RigError` if the table is not the rig's, or another table or driver stands beside the copy.
    """
    rig = rigs.load(rig_file)
    beside: dict[str, tuple[str, bytes]] = {}
    for measured in rig.response_tables:
        beside[measured.response] = "table", response_table(rig_file.parent, measured)
    for driver in rig.driver_files:
        beside[driver.name] = "driver", storage.read_bytes(driver)
    for name, (what, content) in beside.items():
        file = copy.with_name(name)
        if file.exists() and storage.read_bytes(file) != content:
            raise RigError(
                file,
                f"an earlier session used a different {what} with this name",
                f"rename the new {what}, also in the rig file",
                allowed=f"a separate name for each {what}",
            )
        storage.write(file, content)
    storage.write(copy, storage.read_bytes(rig_file))


def open_tracker(
    rig: Rig,
    *,
    clock: Clock,
    port: str | None = None,
    clock_map: ClockMap | None = None,
    contact_mm: float | None = None,
) -> Tracker:
    """Open the rig's tracker, which can be zeroed where the rig asks for it.

    The session's clock stamps arrivals. A `port` replaces the rig's. Without a `clock_map` arrivals give it.
    `contact_mm` is the protocol's, None without steps. Raises `TrackerError` for the port, and `RigError` for the
    driver or a rig without a tracker.
    """
    settings = tracker_of(rig)
    if port is None and settings.port == REHEARSAL:
        raise TrackerError.at(simulated_only(rig, "tracker.port"))
    where = port or settings.port
    tracker: Tracker
    if settings.driver == FRAMES:
        from palpate.experiment.apparatus.tracker.serial_tracker import SerialTracker

        tracker = SerialTracker(where, settings, clock=clock, clock_map=clock_map)
    else:
        guarded = import_module("palpate.experiment.apparatus.tracker.guarded")
        tracker = guarded.open_guarded(rig, where, clock=clock, clock_map=clock_map)
    farthest_mm = settings.zeroing_mm
    if contact_mm is None or farthest_mm is None:
        return tracker
    from palpate.experiment.apparatus.tracker.zeroing import REST_S, ZeroedTracker

    samples = round(REST_S * settings.rate_hz)
    return ZeroedTracker(tracker, contact_mm=contact_mm, farthest_mm=farthest_mm, samples=samples)


def open_pedal(rig: Rig, *, port: str | None = None) -> Pedal | None:
    """Return the rig's pedal once it is there, at its port or another; None where the rig has none.

    Raises `RigError` for one that exists in simulation alone, and `PedalError`.
    """
    if rig.pedal is None:
        return None
    if port is None and rig.pedal.port == REHEARSAL:
        raise RigError.at(simulated_only(rig, "pedal.port"))
    pedal = import_module("palpate.experiment.apparatus.tracker.pedal").Pedal
    return cast("Pedal", pedal(port or rig.pedal.port, rig.pedal.baud))


def open_buttons(
    rig: Rig, mode: Mode, *, clock: Clock, port: str | None = None, known: ClockMap | None = None
) -> Buttons | None:
    """Return the participant's buttons once they are there, at the rig's port or another; None for another `mode`.

    A `known` clock is a simulated one. Raises `RigError` for a rig without any, or simulated ones, and `ButtonsError`.
    """
    if mode != "keys":
        return None
    box = import_module("palpate.experiment.apparatus.wires.buttons").ButtonBox
    if port is not None:
        # A pseudo-terminal has no speed.
        return cast("Buttons", box(port, 115_200, clock=clock, known=known))
    settings = needed(rig, "buttons", rig.buttons, "add it", "because answers.mode is 'keys'")
    if settings.port == REHEARSAL:
        raise RigError.at(simulated_only(rig, "buttons.port"))
    if settings.baud is not None:
        return cast("Buttons", box(settings.port, settings.baud, clock=clock))
    events = import_module("palpate.experiment.apparatus.wires.events").EventButtons
    return cast("Buttons", events(settings.port, settings.named, clock=clock, recorded=rig.rig.simulated))


def open_actuator(
    rig: Rig,
    *,
    limit_m_s2: float,
    drive: Drive | None = None,
    address: str | None = None,
    stream: AudioStream | None = None,
    clock: Clock | None = None,
    drifted: Drifted | None = None,
) -> Actuator:
    """Open the rig's actuator, at its own address or another, or on a channel of the session's stream.

    `limit_m_s2` is the protocol's, for any sample. `drive`, of `conditioning.open_drive`, is for `actuator.shaping`
    alone; `RigError` otherwise. `clock` paces a server, and `drifted` is as in `open_conditioner`. Raises
    `ActuatorError` for a bad address, limit, server or stream.
    """
    settings = rig.actuator
    where = address or settings.address
    if where == REHEARSAL:
        raise ActuatorError.at(simulated_only(rig, "actuator.address"))
    if (drive is None) != (settings.shaping is None):
        got, allowed = ("no", "one") if drive is None else ("a", "none")
        raise RigError(
            f"rig '{rig.rig.name}'",
            f"got {got} frequency shaping for the actuator",
            "correct [actuator.shaping] there",
            allowed=f"{allowed}, as in the rig file",
        )
    from palpate.experiment.apparatus.panel.conditioning import open_conditioner

    condition = open_conditioner(rig, limit_m_s2=limit_m_s2, drive=drive, drifted=drifted)
    if address is None and ":" in settings.driver:
        own = import_module("palpate.experiment.apparatus.wires.own.actuator")
        return cast("Actuator", own.DriverActuator(rig, condition, clock or MonotonicClock()))
    if where is not None:
        pcm = import_module("palpate.experiment.apparatus.panel.pcm").PcmActuator
        server = pcm(where, condition, rate_hz=settings.rate_hz, clock=clock)
        server.reach()
        return cast("Actuator", server)
    from palpate.experiment.apparatus.audio.actuator import AudioActuator

    if stream is None:
        raise ActuatorError(
            f"rig '{rig.rig.name}'",
            "got no audio stream for its actuator",
            "open [audio] first",
            allowed="the session's",
        )
    return AudioActuator(stream, audio_of(rig), condition)
