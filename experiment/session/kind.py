"""The seam between a session and its kinds of trial: what a session lends a kind, and what it asks of one.

A session knows trials, attempts, answers and the journal. What happens between arming and the question, and on which
devices, is the kind's: a room of its name in `kinds/`, as in a protocol file. A kind never imports another.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from datetime import date
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus.ports import Actuator, Tracker
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.clock import Clock
from palpate.experiment.desk.messages import Measured
from palpate.experiment.desk.questions import Arm, Console, Notice
from palpate.experiment.errors import Finding, PalpateError
from palpate.experiment.protocol.designs import Meaning, design_of
from palpate.experiment.protocol.models import Protocol as StudyProtocol
from palpate.experiment.protocol.models import Task
from palpate.experiment.records.entries import Entry, Header, PlannedTrial, Trace, TrainingTrial
from palpate.experiment.records.progress import Progress

if TYPE_CHECKING:
    from palpate.experiment.apparatus.audio.stream import AudioStream
    from palpate.experiment.apparatus.panel.conditioning import Drifted
    from palpate.experiment.apparatus.tracker.clock_map import ClockMap
    from palpate.experiment.synthesis.voltages import Drive
    from palpate.experiment.synthesis.waveforms import Basis


class Signals(Protocol):
    """The rig's triggers: what was sent goes on record before an entry, which is sent after; and stimuli are."""

    def before(self, entry: Entry) -> Sequence[Entry]: ...

    def after(self, entry: Entry) -> None: ...

    def following(self, actuator: Actuator) -> Actuator: ...


@dataclass(frozen=True)
class Sitting:
    """One participant at one task on a rig; files of the rig are beside its file. `recordings` is None without any.

    `drifted` is from a comparison of the panel; None without one. `signals` are triggers.
    """

    protocol: StudyProtocol
    rig: Rig
    rig_file: Path
    participant: str
    task_id: str
    dataset: Path
    recordings: Path | None
    clock: Clock
    drifted: Drifted | None = None
    signals: Signals | None = None


@dataclass(frozen=True)
class Stimuli:
    """A task's materials prepared, by id, and what drives the actuator, None for accelerations; both are constant."""

    materials: Mapping[str, Basis]
    drive: Drive | None


class Log(Protocol):
    """What a session puts on disk for a kind: `write` and `keep` return when it is there, and raise `JournalError`."""

    @property
    def done(self) -> Progress:
        """Where the session stands by what is on disk."""

    def write(self, entry: Entry) -> None:
        """Put an entry into the journal."""

    @property
    def waiting_s(self) -> float:
        """For how long the disk has not answered what is being written, s; 0 while nothing is."""

    def free_bytes(self) -> int:
        """Return the free space on the disk, bytes. Raises `OSError`."""

    def keep(self, raw: bytes) -> Trace:
        """Put raw data into the session's file of them; return where they stand."""


class Limits(Protocol):
    """What a session allows its participant to feel."""

    @property
    def ends_ns(self) -> int:
        """The session time from which on nothing may be felt, ns."""

    def end_reason(self, ahead_ns: int = 0) -> str:
        """Return why nothing may be felt `ahead_ns` from now, or nothing while it may. Raises `PalpateError`."""

    def skip(self, reason: str) -> None:
        """Have nothing felt until `skipped` is called, so that the attempt under way breaks off."""

    def skipped(self) -> str:
        """Return why the attempt is skipped, or nothing, and let what follows be felt."""


def nothing_more(why: str) -> str:
    """Return the sentence for the experimenter that nothing is felt any more, and why, as `Limits.over` says it."""
    return f"Nothing more will be felt: {'paused ' if why.startswith('by ') else ''}{why}."


@dataclass(frozen=True)
class Seen:
    """What a session needs to know of one attempt, once its device's frames are on disk.

    `entry` goes on record. The participant could answer from the session time `answerable_ns` on; None if the attempt
    broke off for a `reason`: if `lost`, a silent device, which `Kind.reconnect` waits for. `failed` is raised once the
    entry is on file. `delivered` is None if nothing measured the stimulus; `repeat` is the protocol's rule, and why.
    """

    entry: Entry
    answerable_ns: int | None = None
    reason: str = ""
    lost: bool = False
    failed: BaseException | None = None
    delivered: bool | None = None
    repeat: str = ""


class Kind(Protocol):
    """The trials of one session, one attempt after the other; what a kind has nothing of is left as it is here."""

    @abstractmethod
    def ready(self, planned: PlannedTrial, attempt: int, answered_ns: int | None) -> None:
        """Lay out and arm an attempt; `answered_ns` is the session time of the answer just before, None without one.

        Nothing is armed once the session's limits are reached. Raises `TrackerStopped` if the device fell silent;
        nothing had begun, and the same attempt is armed again later.
        """

    @abstractmethod
    def watch(self, waiting: Callable[[], AbstractContextManager[None]]) -> Seen:
        """Follow the attempt that is ready to its end; `waiting` is entered while nothing can have been felt.

        It breaks off where the session's limits are reached first.

        Raises `PalpateError` if a part failed before anything can have been felt; later failures come with what was
        seen.
        """

    @property
    def keys(self) -> Mapping[str, str]:
        """Further keys while a question is open, and what each does; none where nothing can be done."""
        return {}

    def press(self, key: str) -> None:
        """Do what one of `keys` stands for. Raises `PalpateError`."""
        raise RuntimeError(f"a kind of trial without keys got {key}")

    @property
    def samples(self) -> Mapping[str, str]:
        """What can be felt while the participant gets familiar, by its key; none where nothing is played then."""
        return {}

    def present(self, key: str) -> bool:
        """Play one of `samples`, and put it on record; return whether it was felt. Raises `PalpateError`."""
        raise RuntimeError(f"a kind of trial without samples got {key}")

    def lacking(self) -> str:
        """Return in a sentence why no answer can count yet, or nothing."""
        return ""

    def rest(self) -> str:
        """Have nothing felt from now on: the question is answered, or is none any more.

        Return why the attempt does not count after all, or nothing. It may be called again.
        """
        return ""

    def quiet(self, why: str) -> None:  # noqa: ARG002
        """Take away at once whatever can be felt, for the session is over or pauses, as `why` says.

        Any thread calls it, again and again while that lasts; it neither writes nor waits for a thread that does.
        """
        return

    def is_silent(self) -> bool | None:
        """Return whether nothing played sounds any more, after a second at most; None for a kind that plays nothing."""
        return None

    def beat(self, ends_ns: int) -> None:  # noqa: ARG002
        """Pass on that the session is alive, and that nothing may be felt from the session time `ends_ns` on.

        A thread calls it every 0.1 s, in real time alone, until the session ends; it waits for nobody either.
        """
        return

    def measured(self) -> Measured:
        """Return what is measured now; it may be called from any thread."""
        return Measured()

    @property
    def probe(self) -> Callable[[], None] | None:
        """What plays the masker's probe once, after it is on record; None where the protocol or the task has none."""
        return None

    def reconnect(self, timeout_s: float) -> None:  # noqa: ARG002
        """Wait until the device that fell silent is back. Raises `TrackerStopped` if it is not back in time."""
        return


@dataclass(frozen=True)
class Lent:
    """What a session lends its kind: entries and frames go to `log`, and nothing is felt beyond `limits`."""

    protocol: StudyProtocol
    header: Header
    console: Console
    clock: Clock
    log: Log
    limits: Limits

    def answers(self, planned: PlannedTrial) -> Mapping[str, Meaning]:
        """Return what each answer key stands for in a trial."""
        task = self.protocol.task(self.header.task)
        return design_of(task.design).answers(self.protocol, planned.presented if task.stimulus == "real" else ())

    def show(self, text: str) -> None:
        """Show the experimenter a line."""
        self.console.tell(Notice(text))

    def arm(self, planned: PlannedTrial, attempt: int, *, may: str, broken_off: str = "") -> bool:
        """Announce an attempt, armed from now on, as `Arm` has it; return whether somebody was waited for."""
        training = isinstance(planned, TrainingTrial)
        of = planned.of if isinstance(planned, TrainingTrial) else len(self.header.order)
        return self.console.ask(Arm(planned.trial, attempt, of, broken_off, may, training)).waited


class KindDevices(Protocol):
    """The opened devices of one kind."""

    def begin(self, lent: Lent) -> Kind:
        """Begin a session with them."""


class FarEnds(Protocol):
    """What stands at the far ends of a session's ports, called as its parts open; `opened` closes in reverse order."""

    @property
    @abstractmethod
    def real_time(self) -> bool:
        """Whether the session runs by the wall clock, so that its priority matters."""

    @property
    @abstractmethod
    def attended(self) -> bool:
        """Whether an experimenter is at the desk, so that the rig's triggers are sent."""

    @property
    @abstractmethod
    def reconnect_s(self) -> float:
        """How long the session waits for a device that fell silent, s; then it is paused."""

    def sound_device(self, opened: ExitStack) -> str | None:  # noqa: ARG002
        """Return the audio device to open; None for the one that the rig names."""
        return None

    def wire_sound(self) -> None:
        """Lay what cables the audio device needs, now that the stream on it is open."""
        return

    def panel(self, site: str | None, opened: ExitStack) -> str | None:  # noqa: ARG002
        """Set up the panel at a site; return where its actuator answers, or None for the address that the rig names."""
        return None

    def stimuli(self, prepare: Callable[[], Stimuli]) -> Stimuli:
        """Return what `prepare` prepares, or what it did for an earlier session of the same rehearsal."""
        return prepare()

    def playing(self, actuator: Actuator, sitting: Sitting, opened: ExitStack) -> Actuator:  # noqa: ARG002
        """Return what plays the stimuli: the actuator, unless something controls for them or listens to them."""
        return actuator

    def force(self, opened: ExitStack) -> str | None:  # noqa: ARG002
        """Set up what pushes the hand; return where it answers, or None for the address that the rig names."""
        return None

    def tracker(self, opened: ExitStack) -> tuple[str | None, ClockMap | None]:  # noqa: ARG002
        """Return the tracker's port, None for the one that the rig names, and its clock where that is known."""
        return None, None

    def pedal(self, opened: ExitStack) -> str | None:  # noqa: ARG002
        """Return the port of the participant's pedal, None for the one that the rig names."""
        return None

    def buttons(self, opened: ExitStack) -> tuple[str | None, ClockMap | None]:  # noqa: ARG002
        """Return the port of the participant's buttons, as `tracker` does."""
        return None, None

    @abstractmethod
    def check(self, tracker: Tracker, rig: Rig) -> None:
        """Refuse a tracker that cannot be used, before anybody is on the panel. Raises `TrackerError`."""

    @abstractmethod
    def console(self) -> Console:
        """Return the experimenter's screen and keys."""


def open_actuator(
    sitting: Sitting,
    drive: Drive | None,
    *,
    stream: AudioStream | None,
    ends: FarEnds,
    opened: ExitStack,
    site: str | None = None,
    limit_m_s2: float | None = None,
) -> Actuator:
    """Open what plays every stimulus of a session, until `opened` closes; errors are those of `opening`.

    The rig is that of a `site`, None for the one panel; `limit_m_s2` is the site's, None for the study's.
    """
    actuator = opening.open_actuator(
        sitting.rig,
        limit_m_s2=sitting.protocol.exposure.vibration_peak_m_s2 if limit_m_s2 is None else limit_m_s2,
        drive=drive,
        address=ends.panel(site, opened),
        stream=stream,
        clock=sitting.clock,
        drifted=sitting.drifted,
    )
    opened.callback(actuator.close)
    playing = ends.playing(actuator, sitting, opened)
    return playing if sitting.signals is None else sitting.signals.following(playing)


@dataclass(frozen=True)
class SessionKind:
    """What a session asks of a kind of trial.

    Attributes:
        opens: opens the devices of a task; arguments are those of `laboratory.open_laboratory`.
        recorded: returns the ids of the materials of which tasks with virtual stimuli play recordings.
        check_rig: refuses a rig with which no session of a study can be run, by its calibration of a day.
        rig: the module that judges rigs, imported where one is judged.
        board: the module of what the board reads of a rig.
        recordings: the module that takes real recordings; none where nothing that is recorded is played.
        frames: returns what tells where the raw data of a task stand, None where none are kept.
    """

    opens: Callable[..., KindDevices]
    recorded: Callable[[StudyProtocol, Sequence[Task]], AbstractSet[str]]
    check_rig: Callable[[StudyProtocol, Rig, date], None]
    rig: str
    board: str
    frames: Callable[[Task], type[Trace] | None]
    recordings: str = ""

    def real_recordings(self, root: Path, given: Path | None, protocol: StudyProtocol) -> Path:
        """Return the given folder of recordings or the dataset's. Raises `RecordingError` if simulated or others."""
        return cast("Path", import_module(self.recordings).real_recordings(root, given, protocol))

    def judge(self, **given: object) -> str:
        """Refuse a rig for tasks with virtual stimuli, or return in words what it leaves out of them."""
        return str(import_module(self.rig).judge(**given))

    def examine(self, **given: object) -> tuple[str, PalpateError | None]:
        """Return in words what the board reads of a rig, and why it is refused for participants, if it is."""
        return cast("tuple[str, PalpateError | None]", import_module(self.board).examine(**given))

    def companions(self, protocol: StudyProtocol) -> Iterable[Finding]:
        """Return what `palpate check` finds of the files that stand beside a protocol."""
        own = protocol.kind_table(protocol.tasks[0]).companions
        return cast("Iterable[Finding]", import_module(self.board).companions(protocol)) if own else ()

    def omissions(self, *given: object) -> Iterable[Finding]:
        """Return what `palpate doctor` finds of what a rig leaves out; nothing where no recordings are played."""
        return cast("Iterable[Finding]", import_module(self.board).omissions(*given)) if self.recordings else ()


def session_kind(task: Task) -> SessionKind:
    """Return the kind of a task; no other is imported."""
    module = f"palpate.experiment.session.kinds.{task.kind}.trials"
    return cast("SessionKind", import_module(module).KIND)
