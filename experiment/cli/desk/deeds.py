"""What can be done for a study now, by the checks that the commands themselves make; each reason is a finding."""

import io
import os
import shlex
import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from datetime import date
from functools import cached_property
from itertools import count
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.cli import files_with, options
from palpate.experiment.cli.analysis import status_of
from palpate.experiment.cli.desk.place import Place
from palpate.experiment.clock import day, wall_ns
from palpate.experiment.dataset.status import Status
from palpate.experiment.desk.console.home import NO, Deed, Field, Scene
from palpate.experiment.desk.terminal import TerminalConsole
from palpate.experiment.errors import Finding, PalpateError
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.approval import sealing
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.progress import progress
from palpate.experiment.rehearsal.study import PRACTICE_SEED, practice_folder
from palpate.experiment.session import run
from palpate.experiment.settings.characters import quoted
from palpate.experiment.study import amendment, approvals, enrolment
from palpate.experiment.study.roster import Roster
from palpate.experiment.study.schedule import allocate, labels

DOES = {
    "new": "Write a new protocol.",
    "edit": "Edit the protocol.",
    "check": "Show the protocol as its ethics board reads it.",
    "seal": "Record the board's approval.",
    "rig": "Choose the rig file, or write a new one.",
    "doctor": "Check the rig. Nobody may be on the panel.",
    "enrol": "Enrol the next participant.",
    "consent": "Record a participant's consent.",
    "practise": "Practise a session with a simulated participant.",
    "begin": "Begin a participant's visit.",
    "resume": "Resume a participant's visit.",
    "withdraw": "Record that a participant withdrew.",
    "status": "Show the study's progress and the flow of participants.",
    "analyse": "Make the tables and the report.",
    "verify": "Check what the dataset proves.",
    "share": "Write a copy of the dataset for others.",
}
"""What a desk does, in the order of a study."""

EDITORS = ("nano", "notepad")
"""That show how they are left; used where the environment names none."""


class Study:
    """A study with what its files say today; what cannot be read is an error beside the rest."""

    def __init__(self, place: Place, file: Path) -> None:
        """Read the protocol. Raises `ProtocolError`."""
        self.place, self.file = place, file
        self.protocol: Protocol = files.load(file)
        self.root = place.dataset or enrolment.default_root(self.protocol)
        self.today: date = day(wall_ns())

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
        enrolment.check_current(self.root, self.protocol, self.roster, ("palpate", "enrol"))

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


def scene(place: Place) -> Scene:
    """Return everything that can be done at a place, and what prevents the rest."""
    if place.protocol is None:
        what, facts = Finding("there is no study in this folder yet"), (("Protocol", "none in this folder yet"),)
        return Scene("palpate", facts, _deeds({"new": _new()}, (what,), "new"), "new")
    try:
        study = Study(place, place.protocol)
    except PalpateError as error:
        own = {"new": _new(), "edit": _edit(place.protocol), "check": _check(place.protocol, None)}
        facts = (("Protocol", error.finding.observation()),)
        return Scene(place.protocol.name, facts, _deeds(own, error.findings, "edit"), "edit")
    own = {
        "new": _new(),
        "edit": _edit(study.file),
        "check": _check(study.file, place.rig),
        "seal": _seal(study),
        "rig": _rig(place),
        "doctor": _doctor(study),
        "enrol": _enrol(study),
        "consent": _consent(study),
        "practise": _practise(study),
        "begin": _session(study, "begin"),
        "resume": _session(study, "resume"),
        "withdraw": _withdraw(study),
        **_of_data(study),
    }
    heading = f"{study.status.heading if study.status else study.protocol.study.id} · {study.protocol.study.title}"
    return Scene(heading, tuple(_facts(study)), _deeds(own, (), ""), _next(study, own), study.status)


def _deeds(own: Mapping[str, Deed], refuses: tuple[Finding, ...], first: str) -> tuple[Deed, ...]:
    return tuple(own.get(name) or _deed(name, refuses=refuses, first=first) for name in DOES)


def _deed(
    name: str,
    *command: str,
    fields: tuple[Field, ...] = (),
    hint: str = "",
    refuses: tuple[Finding, ...] = (),
    first: str = "",
) -> Deed:
    return Deed(name, DOES[name], ("palpate", *command), fields, hint, refuses, first if refuses else "")


def _facts(study: Study) -> Iterator[tuple[str, str]]:
    state, seal = sealing.state(study.file, study.protocol, study.today)
    if not study.unsealed and seal is not None:
        state = f"Sealed until {seal.expires_on}, approval number {seal.approval_number}."
    yield "Protocol", f"{study.file}. {state}"
    if study.place.rig is None:
        yield "Rig", "none chosen; practice needs none"
    else:
        yield "Rig", f"{study.place.rig}. {study.unusable[0].observation() if study.unusable else 'Usable today.'}"
    status = study.status
    people = (
        f"{len(status.those('done'))} done of {status.planned} planned, {len(status.people)} enrolled"
        if status
        else "nobody is enrolled"
    )
    yield "Dataset", f"{study.root}: {people}"


def _next(study: Study, deeds: Mapping[str, Deed]) -> str:
    """Return what comes next in the course of a study."""
    course = ["practise"] if study.data is None else ["edit"] if study.unfilled else []
    course += ["seal", "rig", "resume", "begin", "consent", "enrol", "analyse"]
    wanted = {"rig": study.place.rig is None}
    return next((name for name in course if not deeds[name].refuses and wanted.get(name, True)), "check")


def _new() -> Deed:
    return _deed("new", "new")


def _edit(file: Path) -> Deed:
    named = os.environ.get("VISUAL") or os.environ.get("EDITOR") or ""
    found = next((path for name in EDITORS if (path := shutil.which(name))), None)
    try:
        # A backslash parts the folders of Windows.
        editor = [one.strip('"') for one in shlex.split(named, posix=os.name != "nt")] or [found or ""]
    except ValueError:
        editor = [""]
    what = f"EDITOR is {quoted(named)}, which cannot be started" if named else "no editor is set (EDITOR)"
    none = Finding(f"{what}; open {file} in a window of your own", remedy="the desk reads it again")
    return replace(_deed("edit", refuses=() if shutil.which(editor[0]) else (none,)), command=(*editor, str(file)))


def _check(file: Path, rig: Path | None) -> Deed:
    return _deed("check", "check", str(file), *(("--rig", str(rig)) if rig else ()))


def _day(name: str, option: str, text: str = "", *, wanted: bool = True) -> Field:
    return Field(name, option, text, wanted, check=options.a_day)


def _seal(study: Study) -> Deed:
    refuses, first = study.unfilled, "edit"
    sealed = approval.seal_path(study.file).exists()
    if sealed and not study.unsealed:
        refuses, first = (Finding("this version is sealed already"),), ""
    fields = (
        Field("Approval number", "--approval-number"),
        _day("Approved on", "--approved-on"),
        _day("Expires on", "--expires-on"),
    )
    hint = "As on the board's letter. Days as YYYY-MM-DD."
    command = ("seal", str(study.file), *(("--replace",) if sealed else ()))
    return _deed("seal", *command, fields=fields, hint=hint, refuses=refuses, first=first)


def _rig(place: Place) -> Deed:
    there = files_with("rig")
    text = str(place.rig) if place.rig else "rig.toml"
    hint = f"Here: {', '.join(there)}. " if there else ""
    hint += "A name that is new here becomes a rig file to begin from, which is to be calibrated."
    recordings = Field("Recordings", "", str(place.recordings or ""), wanted=False)
    return replace(_deed("rig", fields=(Field("Rig file", "", text), recordings), hint=hint), command=("rig",))


def _doctor(study: Study) -> Deed:
    rig = study.place.rig
    refuses = () if rig else study.unusable
    command = ("doctor", "--rig", str(rig), "--protocol", str(study.file), *study.recordings, *study.dataset)
    return _deed("doctor", *command, refuses=refuses, first="rig")


def _enrol(study: Study) -> Deed:
    refuses, first, status = study.unfilled, "edit", study.status
    label = labels(study.protocol)[0] if status is None else status.to_enrol
    if status and status.doubts:
        refuses, first = status.doubts, "verify"
    elif label is None:
        refuses, first = (Finding("everybody whom the study plans is enrolled"),), ""
    elif not refuses:
        refuses, first = _as_findings(study.check_current), ""
    consent = _day("Consent on", "--consent-on", wanted=False)
    fields = (Field("Participant", "--participant", label or ""), consent)
    hint = "The day on which they signed, as YYYY-MM-DD; empty: they sign later."
    return _deed(
        "enrol", "enrol", str(study.file), *study.dataset, fields=fields, hint=hint, refuses=refuses, first=first
    )


def _as_findings(check: Callable[[], object]) -> tuple[Finding, ...]:
    try:
        check()
    except PalpateError as error:
        return error.findings
    return ()


def _consent(study: Study) -> Deed:
    known = study.roster
    lacking = [who for who, on in known.consent_on.items() if on is None and who not in known.withdrawn]
    if known.approved:
        all_approvals = known.approvals(approvals.read_first(study.root))
        lacking += amendment.to_reconsent(study.root, all_approvals, known, known.known_day(study.today))
    refuses: tuple[Finding, ...] = ()
    first = ""
    if not study.protocol.consent.required:
        refuses = (Finding("this protocol asks for no consent"),)
    elif not lacking:
        nobody = "everybody enrolled has consented" if known.consent_on else "nobody is enrolled"
        refuses, first = (Finding(nobody),), "" if known.consent_on else "enrol"
    fields = (
        Field("Participant", "--participant", next(iter(lacking), "")),
        _day("Consent on", "--consent-on", str(study.today)),
    )
    hint = f"To consent: {', '.join(lacking)}. The day on which they signed, as YYYY-MM-DD."
    return _deed(
        "consent", "consent", str(study.file), *study.dataset, fields=fields, hint=hint, refuses=refuses, first=first
    )


def _practise(study: Study) -> Deed:
    who, task = study.left_to_practise()
    of = ("--dataset", str(study.practised)) if study.practised != practice_folder(study.protocol) else ()
    fields = (Field("Task", "--task", task, wanted=False), Field("Participant", "--participant", who))
    hint = f"Tasks: {', '.join(one.id for one in study.protocol.tasks)}; empty: all. Nothing here is data of the study."
    lines = tuple(word for word in study.place.session if word == "--lines")
    return _deed("practise", "run", str(study.file), "--practice", *of, *lines, fields=fields, hint=hint)


def _session(study: Study, name: str) -> Deed:
    """Return what begins or resumes a session, with everything that prevents one."""
    people = study.status.those("to begin" if name == "begin" else "under way") if study.status else []
    who = people[0].participant if people else ""
    refuses = study.unsealed + study.unusable
    first = "seal" if study.unsealed else "rig" if study.place.rig is None else "doctor"
    if study.unfilled:
        first = "edit"
    if not who:
        nobody = "nobody enrolled waits for a session" if name == "begin" else "no visit is under way"
        refuses, first = (*refuses, Finding(nobody)), first if refuses else "enrol" if name == "begin" else ""
    elif not refuses:
        refuses, first = _as_findings(lambda: _prepare(study, who)), ""
    hint = f"{', '.join(one.participant for one in people)}. Everything that files can show was checked for {who}."
    fields = (Field("Participant", "--participant", who),)
    return _deed(name, *study.run, fields=fields, hint=hint, refuses=refuses, first=first)


def _prepare(study: Study, who: str) -> None:
    """Make the checks of `palpate run` that open no device and ask nobody. Raises as they do."""
    silent = TerminalConsole(write=io.StringIO(), ask=input, heading="")
    recordings = study.place.recordings if study.recordings else None
    run.prepare(study.file, study.place.rig or Path(), who, None, study.place.dataset, recordings, silent)


def _withdraw(study: Study) -> Deed:
    people = [one.participant for one in study.status.people if one.state != "withdrawn"] if study.status else []
    refuses = () if people else (Finding("nobody is enrolled"),)
    fields = (
        Field("Participant", "--participant"),
        Field("Reason", "--reason", "asked to stop"),
        Field("Erase data", "--erase", NO, flag=True),
    )
    hint = "The reason names no person and no state of health. Before anything is erased, the label is asked for again."
    return _deed(
        "withdraw",
        "withdraw",
        str(study.file),
        *study.dataset,
        fields=fields,
        hint=hint,
        refuses=refuses,
        first="enrol",
    )


def _of_data(study: Study) -> dict[str, Deed]:
    """Return what is done with a dataset; before the study's first session with that of its practice."""
    nothing = () if study.data else (Finding("no session has been run or practised"),)
    given, first = str(study.data), "practise"
    shares: tuple[Finding, ...] = ()
    if study.protocol.sharing is None:
        shares = (Finding("the protocol has no table [sharing], so nothing is shared"),)
    elif study.data != study.root:
        shares = (Finding("no session of the study has been run"),)
    out = (Field("New folder", "", f"{study.root}-shared"),)
    return {
        "status": _deed(
            "status",
            "status",
            str(study.root if study.status else study.data),
            refuses=() if study.status else nothing,
            first=first,
        ),
        "analyse": _deed("analyse", "analyse", given, refuses=nothing, first=first),
        "verify": _deed("verify", "verify", given, refuses=nothing, first=first),
        "share": _deed("share", "share", given, fields=out, refuses=shares),
    }
