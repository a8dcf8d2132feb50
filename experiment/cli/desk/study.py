"""A study with what its files say today, and what the desk calls each thing that can be done with it."""

from collections.abc import Callable
from datetime import date
from functools import cached_property
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.cli import options
from palpate.experiment.cli.analysis import status_of
from palpate.experiment.cli.desk.place import Place
from palpate.experiment.clock import day, wall_ns
from palpate.experiment.dataset.status import Status
from palpate.experiment.desk.console.home import Deed, Field
from palpate.experiment.errors import Finding, PalpateError
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.approval import sealing
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.progress import progress
from palpate.experiment.rehearsal.shorter import shortened
from palpate.experiment.rehearsal.study import PRACTICE_SEED, practice_folder
from palpate.experiment.session import run
from palpate.experiment.settings.characters import quoted
from palpate.experiment.study import enrolment
from palpate.experiment.study.people import enrolling
from palpate.experiment.study.roster import Roster
from palpate.experiment.study.schedule import allocate, labels

DOES = {
    "new": "Write a new protocol.",
    "open": "Choose another study in this folder.",
    "edit": "Edit the protocol.",
    "check": "Show the protocol as the ethics board sees it.",
    "seal": "Record the board's approval.",
    "rig": "Choose the rig file, or write a new one.",
    "calibrate": "Calibrate a device of the rig. Keep everyone off the panel.",
    "doctor": "Check the rig. Keep everyone off the panel.",
    "pilot": "Switch between the study and its pilot.",
    "enrol": "Enroll the next participant.",
    "facts": "Record a participant's answers about themselves.",
    "consent": "Record a participant's consent.",
    "practice": "Practice a session with a simulated participant.",
    "begin": "Start a participant's visit.",
    "resume": "Resume a participant's visit.",
    "incident": "Record an adverse event or a deviation.",
    "withdraw": "Record that a participant withdrew.",
    "amend": "Record the board's amendment or renewal.",
    "suspend": "Record that the board suspended, resumed or ended the study.",
    "status": "Show the study's progress and the flow of participants.",
    "analyse": "Make the tables and the report.",
    "verify": "Verify the dataset's integrity.",
    "share": "Write a copy of the dataset to share.",
}
"""What a desk does, in the order of a study."""

SHORT = 1
"""Repetitions of the first practice: it takes a minute or two, and a whole session ten."""


class Study:
    """A study with what its files say today; what cannot be read is an error beside the rest."""

    def __init__(self, place: Place, file: Path) -> None:
        """Read the protocol. Raises `ProtocolError`."""
        self.place, self.file = place, file
        self.protocol: Protocol = files.load(file)
        self.root = place.dataset or enrolment.default_root(self.protocol)
        self.today: date = day(wall_ns())

    @property
    def pilots(self) -> bool:
        """Whether this is the study's pilot, in its usual folder."""
        return self.place.dataset == enrolment.default_root(self.protocol, pilot=True)

    @property
    def dataset(self) -> tuple[str, ...]:
        """The option that names the dataset, where it is not the default one."""
        return ("--dataset", str(self.root)) if self.place.dataset else ()

    @property
    def run(self) -> tuple[str, ...]:
        """The command of a session, which still lacks the participant."""
        return (
            "run",
            str(self.file),
            "--rig",
            str(self.place.rig),
            *self.recordings,
            *self.dataset,
            *self.place.session,
        )

    @property
    def recordings(self) -> tuple[str, ...]:
        """The option that names the recordings, until the dataset has its own."""
        kept = (self.root / storage.RECORDINGS).exists()
        return ("--recordings", str(self.place.recordings)) if self.place.recordings and not kept else ()

    @cached_property
    def unfilled(self) -> tuple[Finding, ...]:
        """That texts are missing which only the laboratory can write."""
        names = sealing.unfilled(self.protocol)
        what = f"{len(names)} {'text is' if len(names) == 1 else 'texts are'} TO BE FILLED IN: {', '.join(names)}"
        return (Finding(what),) if names else ()

    @cached_property
    def unsealed(self) -> tuple[Finding, ...]:
        """Why the protocol may not be run today."""
        if not approval.seal_path(self.file).exists():
            return (Finding("the protocol is not sealed"),)
        try:
            approval.verify(self.file, self.protocol, self.today)
        except PalpateError as error:
            return error.findings
        return ()

    @cached_property
    def unusable(self) -> tuple[Finding, ...]:
        """Why the rig may not be used."""
        if self.place.rig is None:
            return (Finding("no rig file is chosen"),)
        try:
            run.usable_rig(self.protocol, self.file, self.place.rig, self.today)
        except PalpateError as error:
            return error.findings
        return ()

    @cached_property
    def roster(self) -> Roster:
        """Who is enrolled."""
        return Roster.load(storage.roster_path(self.root))

    @cached_property
    def status(self) -> Status | None:
        """How far the study is; None where nobody is enrolled."""
        return status_of(self.root) if self.roster.consent_on else None

    @cached_property
    def practice(self) -> "Practice":
        """The practice that comes next: a short one of the first participant's tasks, then whole sessions."""
        whole, short = Practice(self.file, None), self.short
        fewer = any(short.trials(one.id) < whole.trials(one.id) for one in self.protocol.tasks)
        first = labels(self.protocol)[0]
        return short if fewer and not whole.begun and short.left and short.left[0] == first else whole

    @cached_property
    def short(self) -> "Practice":
        """A practice with few trials."""
        return Practice(self.file, SHORT)

    def check_current(self) -> None:
        """Raise as `palpate enrol` does of another version, or while the study is suspended or ended."""
        enrolment.check_known(self.root, self.file, self.protocol)
        enrolling.check_current(self.root, self.protocol, self.roster, ("palpate", "enrol"))

    @cached_property
    def data(self) -> Path | None:
        """The dataset of the study or, before its first session, of its practice; None before that too."""
        folders = (self.root, *(practice_folder(self.file, often) for often in (None, SHORT)))
        return next((one for one in folders if _is_begun(one)), None)


class Practice:
    """What is practiced of a protocol, with so many repetitions; None for a session as long as the study's."""

    def __init__(self, protocol_file: Path, repetitions: int | None) -> None:
        """Read what was practiced. Raises `ProtocolError`."""
        self.repetitions = repetitions
        self.folder = practice_folder(protocol_file, repetitions)
        with shortened(protocol_file, repetitions) as file:
            self._protocol = files.load(file)
        self.begun = _is_begun(self.folder)

    def trials(self, task: str) -> int:
        """Return how many trials a task has."""
        return self._protocol.trials(self._protocol.task(task))

    @cached_property
    def left(self) -> tuple[str, ...]:
        """Whose practice comes next, and of which task; nothing once nothing is left."""
        for one in allocate(self._protocol, PRACTICE_SEED):
            for task in one.tasks:
                begun = journal.read_if_begun(storage.journal_path(self.folder, one.participant, task)).entries
                if not (begun and progress(begun).complete):
                    return one.participant, task
        return ()


def _is_begun(folder: Path) -> bool:
    return any(map(storage.size, storage.journals(folder)))


def deed(
    name: str,
    *command: str,
    fields: tuple[Field, ...] = (),
    hint: str = "",
    refuses: tuple[Finding, ...] = (),
    first: str = "",
) -> Deed:
    """Return one thing to do, in the words of `DOES`."""
    return Deed(name, DOES[name], ("palpate", *command), fields, hint, refuses, first if refuses else "")


def as_findings(check: Callable[[], object]) -> tuple[Finding, ...]:
    """Return what a check refuses, nothing where it passes."""
    try:
        check()
    except PalpateError as error:
        return error.findings
    return ()


def day_field(name: str, option: str, text: str = "", *, wanted: bool = True) -> Field:
    """Return a field for a day, as YYYY-MM-DD."""
    return Field(name, option, text, wanted, check=options.a_day)


def a_count(text: str) -> None:
    """Refuse a text that is no number from 1 on, as a field's `check`."""
    if not (text.isdecimal() and int(text)):
        raise PalpateError(
            f"got {quoted(text)}", remedy="type a number, or leave the field empty", allowed="a number, 1 or more"
        )


def one_of(*allowed: str) -> Callable[[str], None]:
    """Return what refuses any other text than these, as a field's `check`."""

    def check(text: str) -> None:
        if text not in allowed:
            raise PalpateError(f"got {quoted(text)}", remedy="type one of them", allowed=", ".join(allowed))

    return check
