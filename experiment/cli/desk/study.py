"""A study with what its files say today, and what the desk calls each thing that can be done with it."""

from collections.abc import Callable, Iterator
from datetime import date
from functools import cached_property
from itertools import count
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
from palpate.experiment.rehearsal.study import PRACTICE_SEED, practice_folder
from palpate.experiment.session import run
from palpate.experiment.settings.characters import quoted
from palpate.experiment.study import enrolment
from palpate.experiment.study.people import enrolling
from palpate.experiment.study.roster import Roster
from palpate.experiment.study.schedule import allocate

DOES = {
    "new": "Write a new protocol.",
    "open": "Choose another study of this folder.",
    "edit": "Edit the protocol.",
    "check": "Show the protocol as its ethics board reads it.",
    "seal": "Record the board's approval.",
    "rig": "Choose the rig file, or write a new one.",
    "calibrate": "Calibrate a device of the rig. Nobody may be on the panel.",
    "doctor": "Check the rig. Nobody may be on the panel.",
    "pilot": "Change between the study and its pilot.",
    "enrol": "Enrol the next participant.",
    "facts": "Record what a participant tells of themselves.",
    "consent": "Record a participant's consent.",
    "practise": "Practise a session with a simulated participant.",
    "begin": "Begin a participant's visit.",
    "resume": "Resume a participant's visit.",
    "incident": "Record an adverse event or a deviation.",
    "withdraw": "Record that a participant withdrew.",
    "amend": "Record the board's amendment or renewal.",
    "suspend": "Record that the board suspends, resumes or ends the study.",
    "status": "Show the study's progress and the flow of participants.",
    "analyse": "Make the tables and the report.",
    "verify": "Check what the dataset proves.",
    "share": "Write a copy of the dataset for others.",
}
"""What a desk does, in the order of a study."""


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
    def practised(self) -> Path:
        """Where this version of the protocol is practised: the first folder without practice of another one."""
        plain, own = practice_folder(self.protocol), approval.sha256(self.protocol)
        numbered = (plain.with_name(f"{plain.name}-{number}") for number in count(2))
        return next(one for one in _and_then(plain, numbered) if _version_practised(one) in ("", own))

    def check_current(self) -> None:
        """Raise as `palpate enrol` does of another version, or while the study is suspended or ended."""
        enrolment.check_known(self.root, self.file, self.protocol)
        enrolling.check_current(self.root, self.protocol, self.roster, ("palpate", "enrol"))

    def left_to_practise(self) -> tuple[str, str]:
        """Return whose practice comes next, and of which task; the last of all once nothing is left."""
        who, task = "", ""
        for one in allocate(self.protocol, PRACTICE_SEED):
            for task in one.tasks:
                who = one.participant
                begun = journal.read_if_begun(storage.journal_path(self.practised, who, task)).entries
                if not (begun and progress(begun).complete):
                    return who, task
        return who, task

    @cached_property
    def data(self) -> Path | None:
        """The dataset of the study or, before its first session, of its practice; None before that too."""
        return next((one for one in (self.root, self.practised) if any(map(storage.size, storage.journals(one)))), None)


def _and_then(first: Path, others: Iterator[Path]) -> Iterator[Path]:
    yield first
    yield from others


def _version_practised(folder: Path) -> str:
    """Return the hash of the protocol that is practised in a folder, empty where none is."""
    try:
        return str(storage.json_of(storage.read_bytes(storage.plan_path(folder)))["protocol_sha256"])
    except (OSError, ValueError, KeyError, TypeError):
        return "" if not folder.exists() or not any(folder.iterdir()) else "unknown"


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


def one_of(*allowed: str) -> Callable[[str], None]:
    """Return what refuses any other text than these, as a field's `check`."""

    def check(text: str) -> None:
        if text not in allowed:
            raise PalpateError(f"got {quoted(text)}", remedy="type one of them", allowed=", ".join(allowed))

    return check
