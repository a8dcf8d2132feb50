"""`palpate doctor`: every part of a rig through the drivers of a session, before anybody is on the panel.

Audio stream and tracker run together at their priorities, so that mutual effects show.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path

from palpate.experiment.apparatus import host, opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.audio import calibration
from palpate.experiment.apparatus.audio.stream import AudioStream
from palpate.experiment.apparatus.doctor import checks, devices
from palpate.experiment.apparatus.doctor.checks import passed, refused, unchecked
from palpate.experiment.apparatus.rig import AudioRig, Rig
from palpate.experiment.clock import Clock, day
from palpate.experiment.errors import AudioError, Finding, PalpateError, RigError, TrackerError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.study import enrolment

TRIALS = 40
"""Trials of a session where no protocol says how many: those of the footstep study."""

FOLDER = Path("participants")
"""Where datasets stand where no protocol says which."""

HIGHEST_RATE_HZ = 5000
"""Rate of a tracker where no rig file says which."""


@dataclass(frozen=True)
class SimulatedPorts:
    """The addresses and devices that are simulated, None for the rig's own; `wire` lays the loopback's cable."""

    port: str | None = None
    address: str | None = None
    device: str | None = None
    force: str | None = None
    pedal: str | None = None
    buttons: str | None = None
    accelerometer: str | None = None
    wire: Callable[[], None] = lambda: None


Views = Mapping[str | None, Rig]
"""The rig as each site of the body has it, None as it is itself."""

Simulate = Callable[[Rig, ExitStack], SimulatedPorts]
"""Starts what is at the far ends of a simulated rig, and has it closed with the stack."""


def examine(
    *,
    rig_path: Path,
    protocol_path: Path | None,
    root: Path | None,
    clock: Clock,
    simulate: Simulate,
    may_move: bool = False,
    presses: int = 0,
) -> Iterator[Finding]:
    """Yield a check of everything, in order of dependence; `ProtocolError` for an unusable protocol.

    Without a protocol only the rig matters. `root` None is the protocol's own dataset, or `participants`. The session's
    clock must go by itself. If the panel `may_move`, it is compared with its measurement. Somebody has to press each of
    the participant's buttons so many times.
    """
    begun = checks.mark(clock)
    protocol = files.load(protocol_path) if protocol_path is not None else None
    rig: Rig | None = None
    try:
        rig = rigs.load(rig_path)
    except RigError as error:
        yield refused("rig file", error)
        yield unchecked("devices", "they are listed in the rig file, which cannot be used")
    else:
        yield from _rig(rig, rig_path, protocol, clock)
    folder = root or (enrolment.default_root(protocol) if protocol is not None else FOLDER)
    rate_hz, readings = _frames(rig)
    # Those of the longest task.
    trials = max(map(protocol.felt_trials, protocol.tasks)) if protocol is not None else TRIALS
    yield checks.space(folder, trials=trials, rate_hz=rate_hz, readings=readings)
    with host.raised() as got:
        yield passed("priority", f"{got}; the same as in sessions")
        for check in _devices(rig, protocol, clock, simulate, presses) if rig is not None else ():
            simulated = ": ".join(part for part in ("SIMULATED", check.place()) if part)
            yield replace(check, where=simulated) if rig and rig.rig.simulated else check
        if rig is not None and rig.actuator.measured is not None:
            from palpate.experiment.apparatus.doctor import sensor

            yield from sensor.load(rig_path, rig, may_move=may_move)
        yield checks.writing(folder, clock)
        yield from checks.privacy(folder)
        yield checks.resolution(clock)
        yield checks.waking(clock)
    yield checks.wall(begun, checks.mark(clock))


def _rig(rig: Rig, path: Path, protocol: Protocol | None, clock: Clock) -> Iterator[Finding]:
    label = "SIMULATED: " if rig.rig.simulated else ""
    yield passed("rig file", f"{label}{path}: rig '{rig.rig.name}', sha256 {rigs.sha256(rig)[:12]}")
    for site in protocol.limits_m_s2 if protocol is not None else ():
        try:
            rig.at(site)
        except RigError as error:
            yield refused("site", error)
    views = _views(rig, protocol)
    yield from _each(views, lambda own: filter(None, [checks.table(own, path.parent)]))
    if protocol is None:
        yield unchecked("gate", "no protocol was given", "add --protocol")
    elif protocol.gate is not None:
        yield checks.reach(rig, protocol.gate)
    today = day(clock.now_ns())
    yield from checks.ages(rig, today)
    for site, own in views.items():
        of_site = checks.ages(own, today) if site is not None else ()
        yield from (replace(one, where=f"site {site}") for one in of_site if one.check == checks.OF_LATENCY)
    if rig.tracker is not None and rig.tracker.force is not None:
        from palpate.experiment.apparatus.doctor import foot_force

        yield foot_force.age(rig, rig.tracker.force, today)
    if protocol is None or protocol.renders:
        yield from _each(views, lambda own: [checks.panel(own, path, today)])
    limits_m_s2 = protocol.limits_m_s2 if protocol is not None and protocol.renders else {}
    yield from checks.stops(rig, {site: one for site, one in limits_m_s2.items() if site in views}, today)


def _devices(rig: Rig, protocol: Protocol | None, clock: Clock, simulate: Simulate, presses: int) -> Iterator[Finding]:
    with ExitStack() as opened:
        try:
            ends = simulate(rig, opened) if rig.rig.simulated else SimulatedPorts()
        except PalpateError as error:
            yield refused("simulated parts", error)
            return
        views = _views(rig, protocol)
        if rig.audio is None:
            yield from _tracker(rig, ends, clock)
        else:
            yield from _audio(rig, rig.audio, views, ends, clock)
        yield from _each(views, lambda own: _actuator(own, ends.address, clock))
        if rig.servo is not None or (protocol is not None and protocol.exposure.force_peak_n is not None):
            from palpate.experiment.apparatus.doctor import force

            yield from force.checks(rig, ends.force, protocol=protocol, clock=clock)
        yield from _pedal(rig, ends.pedal)
        if rig.buttons is not None:
            from palpate.experiment.apparatus.doctor import buttons

            yield from buttons.checks(rig, ends.buttons, presses, clock=clock)
        if rig.triggers:
            from palpate.experiment.apparatus.doctor import triggers

            yield from triggers.checks(rig, clock=clock)
        yield from _elsewhere(rig, protocol)
        if rig.tracker is not None and rig.tracker.zeroing_mm is not None:
            yield unchecked(
                "tracker zero", "each session measures it, with the participant's foot at rest on the panel"
            )
        if rig.accelerometer is not None and (ends.accelerometer or rig.accelerometer.address != rigs.REHEARSAL):
            from palpate.experiment.apparatus.doctor import sensor

            yield from sensor.checks(rig, rig.accelerometer, ends.accelerometer, clock=clock)
        elif rig.accelerometer is not None:
            yield unchecked("accelerometer", "only palpate record, palpate calibrate actuator and sessions read it")


def _actuator(rig: Rig, simulated: str | None, clock: Clock) -> Iterator[Finding]:
    """Yield what an actuator does that is no channel of the audio device; a simulated one is at its address."""
    address = simulated or rig.actuator.address
    if simulated is None and ":" in rig.actuator.driver:
        from palpate.experiment.apparatus.doctor import own

        yield from own.checks(rig, clock)
    elif address is not None:
        yield from checks.server(address, rig.actuator)


def _views(rig: Rig, protocol: Protocol | None) -> Views:
    """Return the rig as each site of the body has it that a protocol uses and the rig has; all without a protocol."""
    used = rig.views if protocol is None else protocol.limits_m_s2
    return {site: own for site, own in rig.views.items() if site in used} or rig.views


def _each(views: Views, checked: Callable[[Rig], Iterable[Finding]]) -> Iterator[Finding]:
    """Yield what is checked of each actuator; a finding of a site names it."""
    for site, own in views.items():
        yield from (one if site is None else replace(one, where=f"site {site}") for one in checked(own))


def _frames(rig: Rig | None) -> tuple[int, int]:
    """Return the frames a second that a session keeps at most, and the readings of each."""
    if rig is None:
        return HIGHEST_RATE_HZ, 1
    return (rig.tracker.rate_hz, rig.tracker.readings) if rig.tracker is not None else (0, 1)


def _pedal(rig: Rig, port: str | None) -> Iterator[Finding]:
    """Yield whether the participant's pedal is there; nothing where the rig has none."""
    name = "pedal"
    try:
        if (pedal := opening.open_pedal(rig, port=port)) is not None:
            pedal.close()
            yield passed(name, "it sends its heartbeat and is not pressed")
    except PalpateError as error:
        yield refused(name, error)


def _elsewhere(rig: Rig, protocol: Protocol | None) -> Iterator[Finding]:
    """Yield what the protocol asks for, and the rig has nothing for."""
    if protocol is None:
        return
    channels = rig.audio.channels if rig.audio is not None else None
    if channels is None and any(task.masker != "none" for task in protocol.tasks):
        yield unchecked("masker", "the rig has no [audio] table: play the masking noise by other means")
    if protocol.answers.microphone and (channels is None or channels.microphone is None):
        yield unchecked(
            "microphone", "the rig has no microphone (audio.channels.microphone), so palpate suggests no answers"
        )
    each = [own.audio for own in _views(rig, protocol).values() if rig.actuator.driver == "audio"]
    heard = each and all(one is not None and one.channels.loopback is not None for one in each)
    if not heard and protocol.renders and any(rule.when == "undelivered" for rule in protocol.exclusion):
        told = "the rig has no actuator loopback, so only the audio stream can detect undelivered stimuli"
        yield unchecked("undelivered", told)


def _tracker(rig: Rig, ends: SimulatedPorts, clock: Clock) -> Iterator[Finding]:
    name, settings = "tracker port", rig.tracker
    if settings is None:
        yield unchecked(name, "the rig has no [tracker] table: it can run only tasks without foot or hand tracking")
        return
    try:
        device = opening.open_tracker(rig, clock=clock, port=ends.port)
    except PalpateError as error:
        yield refused(name, error)
        return
    try:
        with closing(device):
            yield passed(name, f"{ends.port or settings.port} is open")
            try:
                yield from devices.checks(device, settings, clock=clock)
            except TrackerError as error:
                yield refused("tracker", error)
    except TrackerError as error:
        yield refused("tracker closing", error)


def _audio(rig: Rig, settings: AudioRig, views: Views, ends: SimulatedPorts, clock: Clock) -> Iterator[Finding]:
    try:
        stream = calibration.open_probing(rig, views.values(), peak=devices.PEAK, clock=clock, device=ends.device)
    except PalpateError as error:
        yield refused("audio device", error)
        yield from _tracker(rig, ends, clock)
        return
    try:
        with closing(stream):
            yield devices.opened(stream, settings)
            yield from _stream(rig, settings, views, ends, clock, stream)
    except AudioError as error:
        yield refused("audio closing", error)


def _stream(
    rig: Rig, settings: AudioRig, views: Views, ends: SimulatedPorts, clock: Clock, stream: AudioStream
) -> Iterator[Finding]:
    """Check the tracker while a stream runs, then the stream."""
    name = "audio stream"
    try:
        ends.wire()
        since = stream.health
    except AudioError as error:
        yield refused(name, error)
        yield from _tracker(rig, ends, clock)
        return
    yield from _tracker(rig, ends, clock)
    try:
        yield from devices.steady(stream, settings, since=since, exact=rig.rig.simulated)
        yield from devices.microphone(stream, settings)
        yield from _each(views, lambda own: devices.loopback(stream, opening.audio_of(own), own.site))
    except AudioError as error:
        yield refused(name, error)
