"""The sessions of a participant's visit in a real study: from the approved protocol and the roster to the dataset."""

from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from datetime import date
from importlib import import_module
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.ports import Actuator, Tracker
from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.clock import Clock, MonotonicClock, day, minutes, wall_ns
from palpate.experiment.dataset import build, checks, register
from palpate.experiment.desk.questions import YES, Agree, At, Attended, Break, Console, Notice
from palpate.experiment.errors import (
    Interrupted,
    PalpateError,
    Remedy,
    RigError,
    RosterError,
    SessionLocked,
)
from palpate.experiment.findings import shown
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.kinds import kind_of
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Footer, Purpose, Visited
from palpate.experiment.records.progress import progress
from palpate.experiment.session import exposure, remarks, runner, scene, visit
from palpate.experiment.session.kind import FarEnds, Sitting, session_kind
from palpate.experiment.session.laboratory import header, open_laboratory
from palpate.experiment.settings.characters import quoted
from palpate.experiment.study import approvals, enrolment, people, roster
from palpate.experiment.study.admission import Admission, admit, approval_for, check_label, own_journals
from palpate.experiment.study.schedule import Allocation, allocated, find_allocation


class RealEnds(FarEnds):
    """The devices that the rig names, and an experimenter at a console."""

    real_time = attended = True
    reconnect_s = 300.0

    def __init__(self, console: Console) -> None:
        self._console = console

    def playing(self, actuator: Actuator, sitting: Sitting, opened: ExitStack) -> Actuator:
        if sitting.rig.accelerometer is None:
            return actuator
        listening = import_module("palpate.experiment.apparatus.panel.listening")
        trial_s = sitting.protocol.kind_table(sitting.protocol.task(sitting.task_id)).trial_s
        heard: Actuator = listening.open_heard(
            actuator, sitting.rig, sitting.rig_file.parent, sitting.clock, opened, trial_s
        )
        return heard

    def check(self, tracker: Tracker, rig: Rig) -> None:
        from palpate.experiment.apparatus.tracker import zeroing

        zeroing.check_reading(tracker, tracker_of(rig))

    def console(self) -> Console:
        return self._console


def run(
    *,
    protocol_file: Path,
    rig_file: Path,
    participant: str,
    task_id: str | None,
    root: Path | None,
    recordings: Path | None,
    console: Console,
    given: tuple[str, ...],
) -> Footer:
    """Run a participant in the room through what is left of their visit, and bring the dataset up to date.

    The protocol must be sealed, and the participant enrolled. `task_id` None stands for all tasks that are not
    complete, `root` None for `participants/STUDY`, and `recordings` None for those in the dataset. `given` are the
    options that the command of a remedy has. Returns the footer of the last session begun. Raises `PalpateError`, for
    what files can show before a person is asked anything.
    """
    begun = prepare(protocol_file, rig_file, participant, task_id, root, recordings, console, given)
    root, protocol = begun.root, begun.protocol
    visit.ask_first(console, lambda: _ask_consent(root, protocol_file, protocol, participant, console))
    visit.ask_first(console, lambda: _ask_criteria(root, protocol, participant, console))
    visit.ask_first(console, lambda: _ask_voices(root, protocol_file, protocol, participant, console))
    tasks, today = begun.asked_for, day(begun.clock.now_ns())
    enrolled = admit(root, protocol_file, protocol, begun.allocation, tasks[0], given, today).roster
    with enrolment.settling(root, protocol_file, protocol, None, None):
        # The seal of the first session stays in the dataset, and shows under which approval it was begun.
        approvals.keep_first(root, protocol_file)
    begun.consent_on = enrolled.consent_on.get(participant)
    return visit.walk(console=console, tasks=tasks, run=begun.session, noting=begun.noting)


def usable_rig(protocol: Protocol, protocol_file: Path, rig_file: Path, today: date) -> Rig:
    """Return a rig that may be used for participants of a study today. Raises `RigError`, or `PalpateError` for it."""
    rig = rigs.load(rig_file)
    if rig.rig.simulated:
        rehearse = Remedy("give a rig file for real devices, or use {}", ("palpate", "rehearse", str(protocol_file)))
        raise RigError(rig_file, "the rig is simulated", rehearse)
    if protocol.answers.mode != "oral":
        import_module("palpate.experiment.session.answering").check(protocol, rig)
    for one in protocol.tasks:
        session_kind(one).check_rig(protocol, rig, today)
    return rig


def prepare(
    protocol_file: Path,
    rig_file: Path,
    participant: str,
    task_id: str | None,
    root: Path | None,
    recordings: Path | None,
    console: Console,
    given: tuple[str, ...],
) -> "_Visit":
    """Return a visit that nothing on disk prevents; nothing is opened, asked or written. Arguments, errors: `run`."""
    clock = MonotonicClock()
    protocol = files.load(protocol_file)
    today = day(clock.now_ns())
    seal = approval.verify(protocol_file, protocol, today)
    console.tell(
        Notice(
            f"Study {protocol.study.id}, protocol {seal.protocol_sha256[:12]}, approved from {seal.approved_on} to "
            f"{seal.expires_on}: vibration at most {protocol.exposure.vibration_peak_m_s2:g} m/s^2. Approval "
            f"number: {quoted(seal.approval_number)}."
        )
    )
    asked_purpose: Purpose | None = "STUDY" if root is None else None
    root = root or enrolment.default_root(protocol)
    checks.check_roster(root)
    rig = usable_rig(protocol, protocol_file, rig_file, today)
    anchored_in = _anchored_in(rig, rig_file)
    asked_first = _is_asked_first(root, protocol, participant)
    if not asked_first:
        _check_roster(root, protocol_file, protocol, participant, today)
    seed = enrolment.seed_for(root, protocol_file, protocol, None, asked_purpose)
    purpose = enrolment.purpose_of(root)
    if purpose == "PILOT":
        console.tell(Notice(build.LABELS["PILOT"]))
    takes = roster.Roster.load(storage.roster_path(root)).takes
    allocation = find_allocation(allocated(protocol, seed, takes), participant)
    visit.tell_group(console, protocol, allocation)
    checks.load_sound(root)
    if anchored_in:
        register.check_state(root, anchored_in[0], (protocol.study.id, purpose))
    left = tuple(task for task in allocation.tasks if not _is_over(root, protocol_file, allocation, task, today))
    tasks = (task_id,) if task_id else left or allocation.tasks[-1:]
    _check_turn(root, protocol_file, allocation, tasks[0], today)
    if not asked_first:
        admit(root, protocol_file, protocol, allocation, tasks[0], given, today)
    synthesised = [task for task in tasks if scene.plan(protocol=protocol, task_id=task).synthesis]
    for kind, own in {session_kind(one): kind_of(one.kind) for one in map(protocol.task, synthesised)}.items():
        recordings = kind.real_recordings(root, recordings, protocol)
        if (floor := own.floor_m_s2(protocol, participant)) is not None:
            console.tell(Notice(f"Thresholds measured earlier: {participant} feels nothing below {floor:g} m/s^2."))
    _judge_rig(protocol, rig, rig_file, recordings, tasks, console)
    return _Visit(
        protocol_file=protocol_file,
        protocol=protocol,
        rig_file=rig_file,
        rig=rig,
        root=root,
        recordings=recordings,
        allocation=allocation,
        asked_for=tasks,
        seed=seed,
        purpose=purpose,
        anchored_in=anchored_in,
        console=console,
        given=given,
        clock=clock,
    )


@dataclass(kw_only=True)
class _Visit:
    """A visit that may begin; who takes part in it is asked before its first session."""

    protocol_file: Path
    protocol: Protocol
    rig_file: Path
    rig: Rig
    root: Path
    recordings: Path | None
    allocation: Allocation
    asked_for: tuple[str, ...]
    seed: int
    purpose: Purpose
    anchored_in: tuple[Path, Path | None] | None
    console: Console
    given: tuple[str, ...]
    clock: Clock
    consent_on: date | None = None
    _identity: Visited | None = field(default=None, init=False)

    def session(self, task_id: str) -> Footer:
        """Run the session of one task, or the rest of one."""
        root, protocol, rig, console, clock = self.root, self.protocol, self.rig, self.console, self.clock
        participant, tasks = self.allocation.participant, self.allocation.tasks
        steps = visit.visit_steps(tasks)
        # The order of the tasks is concealed until it is known who takes part.
        if self._identity is not None:
            console.tell(At(task_id, steps))
        # Nobody waits for a task that an amendment has under another version since the visit began.
        self._admitted(task_id)
        _wait_for_break(root, protocol, self.allocation, task_id, clock, console)
        self._admitted(task_id)
        planned = scene.plan(protocol=protocol, task_id=task_id)
        noise = ""
        if rig.audio is None and planned.masker is not None:
            noise = (
                f"{planned.masker.capitalize()} noise is played by equipment outside the rig, at most "
                f"{protocol.exposure.masker_level_db_a:g} dB(A), and meets this criterion: {protocol.masker.criterion}"
            )
        used = _keep_recordings(root, self.recordings) if planned.synthesis and self.recordings else None
        # Whoever runs the participant elsewhere is told of before anything is opened or asked.
        theirs = storage.participant_folder(root, participant)
        journal.check_free(theirs, participant)
        complete = _is_complete(root, participant, task_id)
        # Before it is known who takes part, the question may not show which task comes first.
        shown = self.asked_for if self._identity is None else (task_id,)
        panel, drifted = "", None
        if not complete and any(protocol.task(one).stimulus == "virtual" for one in shown):
            compare = import_module("palpate.experiment.desk.panel").compare_panel
            panel, drifted = compare(self.rig_file, rig, console)
        sitting = Sitting(protocol, rig, self.rig_file, participant, task_id, root, used, clock, drifted)
        with ExitStack() as opened:
            try:
                devices = opened.enter_context(open_laboratory(sitting, RealEnds(console)))
            except PalpateError as error:
                _check_others(root, participant, error)
                raise
            if not complete:
                self._admitted(task_id)
                journal.check_free(theirs, participant)
                self._identify()
            console.tell(At(task_id, steps))
            # Nobody who withdrew in the meantime is begun with.
            admission = self._admitted(task_id)
            place = tasks.index(task_id) + 1
            asked = header(sitting, position=place, seed=self.seed, purpose=self.purpose, admission=admission)
            try:
                footer = runner.run(
                    protocol=protocol,
                    header=asked,
                    devices=devices,
                    rig_file=self.rig_file,
                    dataset=root,
                    identity=self._identity,
                    noise=noise,
                    panel=panel,
                    last=task_id == tasks[-1],
                    keeps_voices=protocol.consent.voice_recordings and admission.roster.voices.get(participant, False),
                )
            except (PalpateError, KeyboardInterrupt) as ended:
                # No device is kept, and no priority, while files are written.
                opened.close()
                try:
                    self._update()
                except PalpateError as unbuilt:
                    ended.add_note(f"the dataset could not be updated either: {unbuilt.sentence()}")
                raise
        if footer.reason == "complete" and task_id == tasks[-1] and protocol.answers.microphone:
            from palpate.experiment.desk.voice import enrolling

            enrolling.forget(enrolling.place(root, participant))
        if not self._update() and footer.reason == "complete":
            console.tell(Notice("This session was already complete; nothing was added to it."))
        return footer

    def _update(self) -> bool:
        """Bring the dataset up to date with its journals; return whether it has a new anchor."""
        build.build(self.root)
        return _anchor(self.root, self.anchored_in, self.console)

    def noting(self, task_id: str) -> Attended | None:
        """Return what takes a note while no session is under way: that of the task, or the one before."""
        return remarks.paused(self.root, self.allocation.participant, self.allocation.tasks, task_id, self.clock)

    def _identify(self) -> None:
        """Have it confirmed, once, that the participant of the label is in the room. Raises `Interrupted` if not."""
        who = self.allocation.participant
        if self._identity is not None:
            told = f"participant {who}, as the experimenter confirmed when this program started; not asked again"
            self._identity = Visited(step="identity", text=told)
            return
        done = [task for task in self.allocation.tasks if _is_complete(self.root, who, task)]
        consent = f"Consent was given on {self.consent_on}. " if self.consent_on else ""
        so_far = f"Complete so far: {', '.join(done)}." if done else "No task is complete yet."
        kept = people.known(self.protocol, self.root).get(who)
        name = f", {kept.name}" if kept is not None and kept.name else ""
        text = f"Is the person in front of you participant {who}{name}? {consent}{so_far}"
        if self.console.ask(Agree(text, "yes, continue", "no, leave")).key != YES:
            remedy = "look up the participant's label, and give it with --participant"
            raise Interrupted(
                f"the person in front of you is not participant {who}; nothing was started", remedy=remedy
            )
        self._identity = Visited(step="identity", text=f"participant {who}, as the experimenter confirmed")

    def _admitted(self, task_id: str) -> Admission:
        today = day(self.clock.now_ns())
        return admit(self.root, self.protocol_file, self.protocol, self.allocation, task_id, self.given, today)


def _lacks_consent(root: Path, protocol: Protocol, participant: str) -> bool:
    """Return whether nothing but their consent is missing of an enrolled participant."""
    known = roster.Roster.load(storage.roster_path(root))
    lacks = participant in known.consent_on and known.consent_on[participant] is None
    return protocol.consent.required and lacks and participant not in known.withdrawn


def _is_asked_first(root: Path, protocol: Protocol, participant: str) -> bool:
    """Return whether consent or the criteria of an enrolled participant are asked about before anything else is."""
    return _lacks_consent(root, protocol, participant) or _lacks_criteria(root, protocol, participant)


def _lacks_criteria(root: Path, protocol: Protocol, participant: str) -> bool:
    known = roster.Roster.load(storage.roster_path(root))
    admitted = participant in known.consent_on and participant not in known.withdrawn
    return admitted and not known.is_confirmed(participant, protocol)


def _ask_criteria(root: Path, protocol: Protocol, participant: str, console: Console) -> None:
    """Have each criterion confirmed, and that they are met recorded. Raises `RosterError` where one is not."""
    if not _lacks_criteria(root, protocol, participant):
        return
    criteria = protocol.eligibility.criteria
    for number, criterion in enumerate(criteria, start=1):
        of = f"Criterion {number} of {len(criteria)}"
        text = f"{of}: {' '.join(criterion.split())} Does participant {participant} meet it?"
        if console.ask(Agree(text, "yes, they meet it", "no, or not known")).key != YES:
            what = f"participant {participant} does not meet criterion {number}; nothing was started or recorded"
            remedy = "withdraw the participant without recording a health reason, or ask again another day"
            raise RosterError(what, remedy=remedy)
    known = roster.Roster.continued(storage.roster_path(root))
    known.confirm(participant, criteria, day(wall_ns()))


def _ask_consent(root: Path, protocol_file: Path, protocol: Protocol, participant: str, console: Console) -> None:
    """Have the consent of an enrolled participant recorded who signed the form just now."""
    if not _lacks_consent(root, protocol, participant):
        return
    text = f"Participant {participant} has no recorded consent. Did they read the consent text and sign it today?"
    if console.ask(Agree(text, "yes, record today's consent", "no, leave")).key == YES:
        enrolment.consent(protocol_file, participant, day(wall_ns()), root=root)


def _ask_voices(root: Path, protocol_file: Path, protocol: Protocol, participant: str, console: Console) -> None:
    """Have it recorded whether the sound of a participant's answers may be kept, where nobody has said so."""
    known = roster.Roster.load(storage.roster_path(root))
    admitted = participant in known.consent_on and participant not in known.withdrawn
    if not protocol.consent.voice_recordings or not admitted or participant in known.voices:
        return
    text = f"May recordings of participant {participant}'s answers be saved? The participant can take part either way."
    agreed = console.ask(Agree(text, "yes, save them", "no, save none")).key == YES
    enrolment.voices(protocol_file, participant, agreed, root=root)


def _check_roster(root: Path, protocol_file: Path, protocol: Protocol, participant: str, today: date) -> None:
    """Refuse somebody whom the roster does not allow, before anything else is read of them. Raises `RosterError`."""
    enrolled = roster.Roster.load(storage.roster_path(root))
    approved_on = enrolment.approved_on(root, protocol_file) or today
    enrolled.may_run(participant, protocol, approved_on=approved_on, today=today)


def _anchored_in(rig: Rig, rig_file: Path) -> tuple[Path, Path | None] | None:
    """Return the register that the rig names, if any, and the key that signs there, if any."""
    if (wanted := rig.anchors) is None:
        return None
    try:
        to, *keys = (rig_file.parent / Path(one).expanduser() for one in (wanted.file, wanted.key) if one)
    except RuntimeError as error:
        raise RigError(
            rig_file,
            "anchors: got a path that begins with ~, but the home folder is unknown here",
            "write the full path",
            allowed="a path without ~",
        ) from error
    return to, keys[0] if keys else None


def _anchor(root: Path, anchored_in: tuple[Path, Path | None] | None, console: Console) -> bool:
    """Show a new anchor for the lab book, and enter it where the rig says, if possible; return False for an old one."""
    again = ["palpate", "anchor", str(root)]
    try:
        anchor, is_new = checks.keep_anchor(root)
        if not is_new:
            return False
        console.tell(Notice(f"For the lab book: {anchor.line}", again=True))
        if anchored_in:
            to, key = anchored_in
            again += ["--to", str(to), *(["--sign", str(key)] if key else [])]
            console.tell(Notice(register.enter(anchor, root, to, key)))
    except PalpateError as error:
        mend = f"Fix this problem, then run: {shown(again)}"
        console.tell(Notice(f"NOT ANCHORED: {error.sentence()}. The session is saved. {mend}", again=True))
    return True


def _check_others(root: Path, participant: str, failed: PalpateError) -> None:
    """Tell of a session of another participant, which may be why a device `failed`. Raises `SessionLocked`."""
    for other in roster.Roster.load(storage.roster_path(root)).consent_on:
        if other != participant:
            try:
                journal.check_free(storage.participant_folder(root, other), other)
            except SessionLocked as busy:
                what = f"{busy.finding.what}: participant {participant} cannot begin ({failed.finding.observation()})"
                raise SessionLocked.at(replace(busy.finding, what=what)) from None


def _is_complete(root: Path, participant: str, task_id: str) -> bool:
    own = own_journals(root, participant, (task_id,)).values()
    return any(
        entries and progress(entries).complete for entries in (journal.read_if_begun(path).entries for path in own)
    )


def _is_over(root: Path, protocol_file: Path, allocation: Allocation, task_id: str, today: date) -> bool:
    """Return whether a task is complete, has a session under a wrong label, or was ended by an amendment."""
    known = roster.Roster.load(storage.roster_path(root))
    approved = known.approvals(approvals.read_first(root, protocol_file))
    ended = approval_for(root, allocation, task_id, approved, known.known_day(today)) is None
    who = allocation.participant
    return ended or known.label_of(who, task_id) != who or _is_complete(root, who, task_id)


def _check_turn(root: Path, protocol_file: Path, allocation: Allocation, task_id: str, today: date) -> None:
    """Refuse a task that is not the participant's, or whose turn has not come."""
    who, tasks = allocation.participant, allocation.tasks
    if task_id not in tasks:
        raise RosterError(
            f"participant {who} does not do task '{task_id}'", remedy="choose one of these", allowed=", ".join(tasks)
        )
    check_label(roster.Roster.load(storage.roster_path(root)), who, task_id)
    for earlier in tasks[: tasks.index(task_id)]:
        if not _is_over(root, protocol_file, allocation, earlier, today):
            what = f"participant {who} must complete task '{earlier}' before '{task_id}'"
            raise RosterError(what, remedy=f"run '{earlier}' first")


def _judge_rig(
    protocol: Protocol, rig: Rig, rig_file: Path, recordings: Path | None, tasks: tuple[str, ...], console: Console
) -> None:
    """Show what the rig leaves out of the tasks' virtual stimuli. Raises `RigError` for one that may not be used."""
    today = day(wall_ns())
    virtual = tuple(task for task in tasks if protocol.task(task).stimulus == "virtual")
    for kind in {session_kind(protocol.task(task)): None for task in virtual}:
        told = kind.judge(
            protocol=protocol, rig=rig, rig_file=rig_file, recordings=recordings, task_ids=virtual, today=today
        )
        if told:
            console.tell(Notice(f"Rig '{rig.rig.name}': {told}."))
    if virtual:
        rigs.check_stops(rig, protocol.limits_m_s2, today)


def _keep_recordings(root: Path, folder: Path) -> Path:
    """Return the recordings in the dataset; they are copied there at the first session that names them."""
    kept = root / storage.RECORDINGS
    if not kept.exists():
        with storage.new_folder(kept) as partial:
            for file in filter(Path.is_file, folder.rglob("*")):
                storage.create(partial / file.relative_to(folder), file.read_bytes())
    return kept


def _wait_for_break(
    root: Path, protocol: Protocol, allocation: Allocation, task_id: str, clock: Clock, console: Console
) -> None:
    """Let the protocol's break pass since the participant's other tasks, whatever label they were done under."""
    own = own_journals(root, allocation.participant, (one.id for one in protocol.tasks))
    for other, path in own.items():
        before = journal.read_if_begun(path)
        if other == task_id or not before.lines:
            continue
        left_ns = int(protocol.task_order.break_min_s * 1e9) - exposure.since_ended_ns(before, clock)
        if left_ns > 0:
            why = f"The break after task {other} lasts at least {minutes(protocol.task_order.break_min_s)}."
            console.attend(remarks.paused(root, before.header.participant, (), other, clock))
            try:
                console.ask(Break(why, left_ns / 1e9))
            finally:
                console.attend(None)
