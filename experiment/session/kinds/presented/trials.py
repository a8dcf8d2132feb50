"""Presented stimuli as a kind of trial: set off by somebody or the clock, one after the other, and asked about then."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, replace
from datetime import date
from typing import TYPE_CHECKING

from palpate.experiment.apparatus.panel.conditioning import open_drive
from palpate.experiment.apparatus.ports import Actuator
from palpate.experiment.desk.messages import Measured
from palpate.experiment.desk.questions import INTERRUPTED, Play, Played, Playing
from palpate.experiment.errors import ActuatorError, cause
from palpate.experiment.protocol.kinds.presented import SAMPLE_KEYS, Presented
from palpate.experiment.records.entries import PlannedTrial
from palpate.experiment.records.kinds.presented import CutShort, Interval, Presentation, Sample, all_delivered
from palpate.experiment.session.kind import FarEnds, Kind, Lent, Seen, SessionKind, Sitting, open_actuator
from palpate.experiment.session.kinds.presented.stimuli import rendered, scaled

if TYPE_CHECKING:
    from palpate.experiment.apparatus.audio.stream import AudioStream
    from palpate.experiment.apparatus.panel import conditioning
    from palpate.experiment.apparatus.rig import Rig
    from palpate.experiment.protocol.models import ExclusionRule, Protocol, Task
    from palpate.experiment.records.stimulus import Delivered
    from palpate.experiment.synthesis.signals.waves import Declared

SILENT_NS = 1_000_000_000
"""So long the device of an earlier stimulus may take to fall silent, ns."""

LOOK_NS = 5_000_000
"""Between two looks at what is waited for, ns."""

AHEAD_NS = 5_000_000
"""A stimulus is aimed at so long beyond the actuator's own lead, ns. Ours."""

MARKED_NS = 250_000_000
"""A stimulus of several is marked on the screen so long before it begins, ns, or half of the pause before. Ours."""

SAMPLES_APART_NS = 1_000_000_000
"""So much silence at least before a stimulus of the familiarisation, ns. Ours."""

MAY = "feel the next stimulus"
"""What the participant may do once an attempt is armed."""

STILL_PLAYS = "the last stimulus may still be playing; restart the actuator's server, then resume the session"


@dataclass(frozen=True)
class PresentedDevices:
    """Implements `KindDevices`: the actuator of each site, and the stimuli of materials, by their ids."""

    actuators: Mapping[str | None, Actuator]
    stimuli: Mapping[str, Declared]

    def begin(self, lent: Lent) -> Presentations:
        return Presentations(self, lent)


def open_presented(sitting: Sitting, stream: AudioStream | None, ends: FarEnds, opened: ExitStack) -> PresentedDevices:
    """Open what a task needs; otherwise as `laboratory.open_laboratory`. Raises `SynthesisError` as `rendered`."""
    protocol = sitting.protocol
    stimuli, actuators = rendered(protocol, sitting.rig.actuator.rate_hz), dict[str | None, Actuator]()
    for site, limit_m_s2 in protocol.limits_m_s2.items():
        own = replace(sitting, rig=sitting.rig.at(site))
        drive = open_drive(sitting.rig_file.parent, own.rig.actuator, limit_m_s2=limit_m_s2)
        actuators[site] = open_actuator(
            own, drive, stream=stream, ends=ends, opened=opened, site=site, limit_m_s2=limit_m_s2
        )
    return PresentedDevices(actuators, stimuli)


@dataclass(frozen=True)
class Armed:
    """An attempt that is ready; nothing of it is felt before the session time `from_ns`, ns."""

    planned: PlannedTrial
    attempt: int
    from_ns: int


@dataclass
class Sounded:
    """A stimulus that was, or may be, felt: of a material, asked for at a session time, ns, and what was heard."""

    material: str
    site: str | None
    onset_ns: int
    played: conditioning.Played
    delivered: Delivered | None = None

    def on_record(self) -> Interval:
        """Return what goes on record of it; it takes a while to say."""
        stimulus = self.played.on_record()
        return Interval(
            material=self.material,
            onset_ns=self.onset_ns,
            stimulus=stimulus,
            delivered=self.delivered,
            site=self.site,
        )

    @property
    def ends_ns(self) -> int:
        """When it ends, session time, ns: by when it was heard, or else by when it was asked for."""
        heard = None if self.delivered is None else self.delivered.onset_ns
        began_ns = self.onset_ns if heard is None else heard
        return began_ns + self.played.samples.size * 10**9 // self.played.stimulus.rate_hz


class Presentations(Kind):
    """Each attempt is what its trial presents, one stimulus after the other."""

    def __init__(self, devices: PresentedDevices, lent: Lent) -> None:
        """Set up before the first attempt."""
        self._devices, self._lent = devices, lent
        self._table = lent.protocol.table(Presented)
        self._armed: Armed | None = None
        self._sounded: list[Sounded] = []
        self._delivered: bool | None = None

    def ready(self, planned: PlannedTrial, attempt: int, answered_ns: int | None) -> None:
        """Arm the attempt, once nothing of an earlier one sounds. Raises `ActuatorError` if something may."""
        clock, limits = self._lent.clock, self._lent.limits
        silent = self._falls_silent(limits.end_reason)
        if limits.end_reason():
            return
        if not silent:
            raise ActuatorError("actuator", STILL_PLAYS)
        self._lent.arm(planned, attempt, may=MAY)
        since_ns = clock.now_ns() if answered_ns is None else answered_ns
        self._armed = Armed(planned, attempt, since_ns + int(self._table.gap_s * 1e9))

    def watch(self, waiting: Callable[[], AbstractContextManager[None]]) -> Seen:
        """Wait until the stimuli are set off, and play them."""
        armed, self._armed = self._armed, None
        if armed is None:
            raise RuntimeError("nothing is presented before it was armed")
        self._sounded = []
        with waiting():
            reason = self._set_off(armed)
        if reason:
            return self._cut_short(armed, reason)
        try:
            reason = self._present(armed)
        except BaseException as failed:
            why = INTERRUPTED if isinstance(failed, KeyboardInterrupt) else cause(failed)
            if not self._sounded:
                raise
            return self._cut_short(armed, why, failed)
        return self._cut_short(armed, reason) if reason else self._seen(armed)

    @property
    def samples(self) -> Mapping[str, str]:
        return {key: self._sample(material, level) for key, (material, level) in self._keyed}

    def _sample(self, material: str, level: float) -> str:
        """Return what the experimenter calls a stimulus of the familiarization."""
        site = self._table.site_of[material]
        times, at = "" if level == 1.0 else f" x {level:g}", "" if site is None else f" at {site}"
        return f"{material}{times}{at}"

    @property
    def _keyed(self) -> Iterator[tuple[str, tuple[str, float]]]:
        """Yield each stimulus of the familiarisation by its key: with levels, at the strongest and the weakest."""
        task = self._lent.protocol.task(self._lent.header.task)
        levels = (1.0,) if task.levels is None else (task.levels.grid[-1], task.levels.grid[0])
        own = self._lent.protocol.materials_of(task)
        silent = {one for one in own if not self._devices.stimuli[one].waveform_m_s2.any()}
        felt = [(one, level) for one in own for level in ((1.0,) if one in silent else levels)]
        keys = {one.id: one.key for one in self._lent.protocol.materials if one.key}
        named = all(one in keys for one in own) and len(levels) == 1
        return zip([keys[one] for one in own] if named else SAMPLE_KEYS, felt, strict=False)

    def present(self, key: str) -> bool:
        material, level = dict(self._keyed)[key]
        self._sounded, apart_ns = [], max(int(self._table.gap_s * 1e9), SAMPLES_APART_NS)
        stimulus, from_ns = scaled(self._devices.stimuli[material], level), self._lent.clock.now_ns() + apart_ns
        try:
            reason = self._play(material, stimulus, from_ns)
        finally:
            intervals = tuple(one.on_record() for one in self._sounded)
            for one in intervals:
                self._lent.log.write(Sample(level=level, interval=one))
        self._lent.console.tell(Played(0, 1))
        felt = not reason and all_delivered(intervals) is not False
        if not felt:
            heard = (one.delivered.reason for one in intervals if one.delivered)
            self._lent.show(f"This does not count as felt: {reason or '; '.join(filter(None, heard))}.")
        return felt

    def _set_off(self, armed: Armed) -> str:
        """Wait until something or somebody sets the stimuli off; return why nothing may be felt, or nothing."""
        if reason := self._wait_until(armed.from_ns):
            return reason
        if self._table.set_off != "clock":
            self._lent.console.ask(Play(armed.planned.trial, self._table.set_off))
        return self._lent.limits.end_reason()

    def _wait_until(self, at_ns: int) -> str:
        """Wait for a session time, ns; return why nothing may be felt any more, or nothing."""
        clock = self._lent.clock
        while (left_ns := at_ns - clock.now_ns()) > 0:
            if reason := self._lent.limits.end_reason():
                return reason
            clock.sleep_ns(left_ns if clock.simulated else min(left_ns, LOOK_NS))
        return self._lent.limits.end_reason()

    def _present(self, armed: Armed) -> str:
        """Play what a trial presents; return why it ended early, or nothing."""
        level = self._lent.log.done.levels.get(armed.planned.trial, 1.0)
        pause_ns, from_ns = int((self._table.pause_s or 0.0) * 1e9), 0
        several = len(armed.planned.presented) > 1
        for place, material in enumerate(armed.planned.presented, start=1):
            if several:
                from_ns = from_ns or self._lent.clock.now_ns() + MARKED_NS
                if reason := self._wait_until(from_ns - (min(MARKED_NS, pause_ns // 2) if place > 1 else MARKED_NS)):
                    return reason
                self._lent.console.tell(Playing(place))
            if reason := self._play(material, scaled(self._devices.stimuli[material], level), from_ns):
                return reason
            from_ns = self._sounded[-1].ends_ns + pause_ns
            self._lent.console.tell(Played(armed.planned.trial, place))
        return ""

    def _play(self, material: str, stimulus: Declared, from_ns: int) -> str:
        """Play a stimulus at a session time, ns, or soon after, to its end; return why it ended early, or nothing."""
        clock, site = self._lent.clock, self._table.site_of[material]
        actuator = self._devices.actuators[site]
        ahead_ns = actuator.lead_ns + AHEAD_NS if actuator.lead_ns else 0
        played = actuator.prepare(stimulus)
        if reason := self._wait_until(from_ns - ahead_ns):
            actuator.withdraw()
            return reason
        one = Sounded(material, site, max(from_ns, clock.now_ns() + ahead_ns), played)
        self._sounded.append(one)
        if not (ahead_ns and actuator.aim(one.onset_ns)):
            one.onset_ns = clock.now_ns()
        actuator.landed(one.onset_ns)
        if clock.simulated:
            clock.sleep_ns(one.ends_ns - clock.now_ns())
        one.delivered = actuator.delivered(one.onset_ns)
        if not self._falls_silent(self._lent.limits.end_reason) and not self._lent.limits.end_reason():
            raise ActuatorError("actuator", STILL_PLAYS)
        return self._lent.limits.end_reason()

    def _seen(self, armed: Armed) -> Seen:
        planned = armed.planned
        entry = Presentation(
            trial=planned.trial,
            attempt=armed.attempt,
            presented=planned.presented,
            intervals=tuple(one.on_record() for one in self._sounded),
            set_off=self._table.set_off,
        )
        self._delivered = all_delivered(entry.intervals)
        return Seen(
            entry,
            answerable_ns=entry.intervals[-1].began_ns,
            delivered=self._delivered,
            repeat=_repeat(self._lent.protocol.exclusion, self._delivered),
        )

    def _cut_short(self, armed: Armed, reason: str, failed: BaseException | None = None) -> Seen:
        planned = armed.planned
        entry = CutShort(
            trial=planned.trial,
            attempt=armed.attempt,
            presented=planned.presented,
            intervals=tuple(one.on_record() for one in self._sounded),
            reason=reason,
        )
        if entry.intervals and failed is None:
            self._lent.show(f"This presentation does not count: {reason}.")
        return Seen(entry, reason=reason, failed=failed)

    def quiet(self, why: str) -> None:  # noqa: ARG002
        """Take back the stimulus that is prepared, and hang up on one that plays."""
        for actuator in self._devices.actuators.values():
            actuator.withdraw()

    def is_silent(self) -> bool:
        """Return whether the actuator is silent, and tell the experimenter if it is not."""
        silent = self._falls_silent(lambda: "")
        if not silent:
            self._lent.show(f"The panel may move at any time: {STILL_PLAYS}.")
        return silent

    def _falls_silent(self, over: Callable[[], str]) -> bool:
        """Return whether no earlier stimulus can sound any more; wait for that, unless the session is over."""
        clock, actuators = self._lent.clock, self._devices.actuators.values()
        ends_ns = clock.now_ns() + SILENT_NS
        while not all(actuator.is_silent() for actuator in actuators):
            if over() or clock.now_ns() >= ends_ns:
                return False
            clock.sleep_ns(LOOK_NS)
        return True

    def measured(self) -> Measured:
        """Return how the last presentation went."""
        return Measured(delivered=self._delivered)


def _repeat(rules: Sequence[ExclusionRule], delivered: bool | None) -> str:
    """Return why the protocol has a presentation done again, if it has."""
    for rule in rules:
        if rule.action == "repeat-trial" and rule.when == "undelivered" and delivered is False:
            return f"{rule.id}: {rule.reason}"
    return ""


def _recorded(protocol: Protocol, tasks: Sequence[Task]) -> set[str]:  # noqa: ARG001
    """Return none: what is played is declared."""
    return set()


def _check_rig(protocol: Protocol, rig: Rig, today: date) -> None:
    """Nothing follows anybody; what the rig makes of the stimuli is judged by `fidelity`."""


_FIDELITY = "palpate.experiment.session.kinds.presented.fidelity"
KIND = SessionKind(open_presented, _recorded, _check_rig, _FIDELITY, _FIDELITY, frames=lambda _: None)
