"""What the desk offers at each point of a study, why it does not offer the rest, and what it does."""

import io
import os
import shlex
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import count
from pathlib import Path

from palpate.experiment.cli import files_with
from palpate.experiment.cli.desk import board
from palpate.experiment.cli.desk.place import Place
from palpate.experiment.cli.desk.study import DOES, SHORT, Study, a_count, as_findings, day_field, deed, one_of
from palpate.experiment.desk.console.home import NO, Deed, Field, Scene
from palpate.experiment.desk.terminal import TerminalConsole
from palpate.experiment.errors import Finding, PalpateError
from palpate.experiment.protocol import approval
from palpate.experiment.protocol.approval import sealing
from palpate.experiment.session import run
from palpate.experiment.settings.characters import quoted
from palpate.experiment.study import amendment, approvals, enrolment
from palpate.experiment.study.schedule import labels

EDITORS = ("nano", "notepad")
"""That show how they are left; used where the environment names none."""


def scene(place: Place) -> Scene:
    """Return everything that can be done at a place, and what prevents the rest."""
    if place.protocol is None:
        what, facts = Finding("this folder does not contain a study yet"), (("Protocol", "none in this folder"),)
        return Scene("palpate", facts, _deeds({"new": _new()}, (what,), "new"), "new")
    try:
        study = Study(place, place.protocol)
    except PalpateError as error:
        own = {
            "new": _new(),
            "open": _open(place),
            "edit": _edit(place.protocol),
            "check": _check(place.protocol, None),
        }
        facts = (("Protocol", error.finding.observation()),)
        return Scene(place.protocol.name, facts, _deeds(own, error.findings, "edit"), "edit")
    own = {
        "new": _new(),
        "open": _open(place),
        "edit": _edit(study.file),
        "check": _check(study.file, place.rig),
        "seal": _seal(study),
        "rig": _rig(place),
        "calibrate": _calibrate(study),
        "doctor": _doctor(study),
        "pilot": _pilot(study),
        "enrol": _enrol(study),
        "facts": _tell_facts(study),
        "consent": _consent(study),
        "practice": _practice(study),
        "begin": _session(study, "begin"),
        "resume": _session(study, "resume"),
        "incident": board.incident(study),
        "withdraw": _withdraw(study),
        "amend": board.amend(study),
        "suspend": board.suspend(study),
        **_of_data(study),
    }
    heading = f"{study.status.heading if study.status else study.protocol.study.id} · {study.protocol.study.title}"
    return Scene(heading, tuple(_facts(study)), _deeds(own, (), ""), _next(study, own), study.status)


def _deeds(own: Mapping[str, Deed], refuses: tuple[Finding, ...], first: str) -> tuple[Deed, ...]:
    return tuple(own.get(name) or deed(name, refuses=refuses, first=first) for name in DOES)


def _facts(study: Study) -> Iterator[tuple[str, str]]:
    state, seal = sealing.state(study.file, study.protocol, study.today)
    if not study.unsealed and seal is not None:
        state = f"Sealed until {seal.expires_on} (approval {seal.approval_number})."
    yield "Protocol", f"{study.file}. {state}"
    if study.place.rig is None:
        yield "Rig", "none chosen (not needed for practice)"
    else:
        yield "Rig", f"{study.place.rig}. {study.unusable[0].observation() if study.unusable else 'Usable today.'}"
    status = study.status
    people = (
        f"{len(status.those('done'))} of {status.planned} planned done, {len(status.people)} enrolled"
        if status
        else "nobody is enrolled"
    )
    yield "Pilot" if study.pilots else "Dataset", f"{study.root}: {people}"


def _next(study: Study, deeds: Mapping[str, Deed]) -> str:
    """Return what comes next in the course of a study."""
    course = ["practice"] if study.data is None else ["edit"] if study.unfilled else []
    course += ["seal", "rig", "resume", "begin", "consent", "enrol", "analyse"]
    wanted = {"rig": study.place.rig is None}
    return next((name for name in course if not deeds[name].refuses and wanted.get(name, True)), "check")


def _new() -> Deed:
    return deed("new", "new")


def _open(place: Place) -> Deed:
    there = [name for name in files_with("study") if place.protocol is None or Path(name) != place.protocol]
    refuses = () if there else (Finding("this folder does not contain another study"),)
    fields = (Field("Protocol", "", next(iter(there), ""), check=_readable),)
    hint = f"Here: {', '.join(there)}."
    return replace(deed("open", fields=fields, hint=hint, refuses=refuses), command=("open",))


def _readable(name: str) -> None:
    if not Path(name).is_file():
        raise PalpateError(f"got {quoted(name)}", remedy="name one of these files", allowed="a protocol file")


def _edit(file: Path) -> Deed:
    named = os.environ.get("VISUAL") or os.environ.get("EDITOR") or ""
    found = next((path for name in EDITORS if (path := shutil.which(name))), None)
    try:
        # A backslash parts the folders of Windows.
        editor = [one.strip('"') for one in shlex.split(named, posix=os.name != "nt")] or [found or ""]
    except ValueError:
        editor = [""]
    what = f"EDITOR is {quoted(named)}, which was not found" if named else "no editor is set (EDITOR)"
    none = Finding(f"{what}; open {file} in your own editor", remedy="the desk reloads it when you save")
    return replace(deed("edit", refuses=() if shutil.which(editor[0]) else (none,)), command=(*editor, str(file)))


def _check(file: Path, rig: Path | None) -> Deed:
    return deed("check", "check", str(file), *(("--rig", str(rig)) if rig else ()))


def _seal(study: Study) -> Deed:
    refuses, first = study.unfilled, "edit"
    sealed = approval.seal_path(study.file).exists()
    if sealed and not study.unsealed:
        refuses, first = (Finding("this version is already sealed"),), ""
    fields = (
        Field("Approval number", "--approval-number"),
        day_field("Approved on", "--approved-on"),
        day_field("Expires on", "--expires-on"),
    )
    hint = "Copy these from the board's letter. Write dates as YYYY-MM-DD."
    command = ("seal", str(study.file), *(("--replace",) if sealed else ()))
    return deed("seal", *command, fields=fields, hint=hint, refuses=refuses, first=first)


def _rig(place: Place) -> Deed:
    there = files_with("rig")
    text = str(place.rig) if place.rig else "rig.toml"
    hint = f"Here: {', '.join(there)}. " if there else ""
    hint += "A new name creates a starter rig file, which you then calibrate."
    recordings = Field("Recordings", "", str(place.recordings or ""), wanted=False)
    return replace(deed("rig", fields=(Field("Rig file", "", text), recordings), hint=hint), command=("rig",))


def _calibrate(study: Study) -> Deed:
    rig = study.place.rig
    numbered = (rig.with_name(f"{rig.stem}-{number}.toml") for number in count(2)) if rig else iter(())
    new = next((str(one) for one in numbered if not one.exists()), "")
    fields = (
        Field("Device", "", "tracker", check=one_of("tracker", "audio", "actuator")),
        Field("Rig file", "--rig", str(rig or "")),
        Field("New rig file", "--out", new),
    )
    hint = "Devices: tracker, audio, actuator. The result is a new rig file; choose it with 'rig'."
    refuses = () if rig else study.unusable
    return deed("calibrate", "calibrate", fields=fields, hint=hint, refuses=refuses, first="rig")


def _doctor(study: Study) -> Deed:
    rig = study.place.rig
    refuses = () if rig else study.unusable
    command = ("doctor", "--rig", str(rig), "--protocol", str(study.file), *study.recordings, *study.dataset)
    return deed("doctor", *command, refuses=refuses, first="rig")


def _pilot(study: Study) -> Deed:
    """Return what changes to the pilot, or back; another dataset that was named has none."""
    root = enrolment.default_root(study.protocol, pilot=True)
    named = study.place.dataset is not None and not study.pilots
    refuses = (Finding(f"the desk was opened with the dataset {study.root}"),) if named else ()
    there = () if study.pilots else (str(root),)
    what = (
        "Switch back to the study."
        if study.pilots
        else f"Switch to the pilot in {root}, separate from the study's data."
    )
    return replace(deed("pilot", refuses=refuses), command=("pilot", *there), does=what)


def _enrol(study: Study) -> Deed:
    refuses, first, status = study.unfilled, "edit", study.status
    label = labels(study.protocol)[0] if status is None else status.to_enrol
    if status and status.doubts:
        refuses, first = status.doubts, "verify"
    elif label is None:
        refuses, first = (Finding("all planned participants are enrolled"),), ""
    elif not refuses:
        refuses, first = as_findings(study.check_current), ""
    consent = day_field("Consent on", "--consent-on", wanted=False)
    fields = (Field("Participant", "--participant", label or ""), consent)
    hint = "Date of signature (YYYY-MM-DD); leave empty if they sign later."
    return deed(
        "enrol",
        "enrol",
        str(study.file),
        *study.dataset,
        *(("--pilot",) if study.pilots else ()),
        fields=fields,
        hint=hint,
        refuses=refuses,
        first=first,
    )


def _tell_facts(study: Study) -> Deed:
    who = [one for one in study.roster.consent_on if one not in study.roster.withdrawn]
    refuses, first = () if who else (Finding("nobody is enrolled"),), "enrol"
    if not getattr(getattr(study.protocol, "asked", None), "people", ()):
        refuses, first = (Finding("the protocol has no questions about participants ([[asked.people]])"),), ""
    fields = (
        Field("Participant", "--participant", next(iter(who), "")),
        Field("Correction", "--fact", wanted=False),
    )
    hint = "Correction: ID=ANSWER, such as age=34; leave empty to be asked the unanswered questions."
    return deed(
        "facts", "facts", str(study.file), *study.dataset, fields=fields, hint=hint, refuses=refuses, first=first
    )


def _consent(study: Study) -> Deed:
    known = study.roster
    lacking = [who for who, on in known.consent_on.items() if on is None and who not in known.withdrawn]
    if known.approved:
        all_approvals = known.approvals(approvals.read_first(study.root))
        lacking += amendment.to_reconsent(study.root, all_approvals, known, known.known_day(study.today))
    refuses: tuple[Finding, ...] = ()
    first = ""
    if not study.protocol.consent.required:
        refuses = (Finding("this protocol does not require consent"),)
    elif not lacking:
        nobody = "everybody enrolled has consented" if known.consent_on else "nobody is enrolled"
        refuses, first = (Finding(nobody),), "" if known.consent_on else "enrol"
    fields = (
        Field("Participant", "--participant", next(iter(lacking), "")),
        day_field("Consent on", "--consent-on", str(study.today)),
    )
    hint = f"Consent missing: {', '.join(lacking)}. Date of signature (YYYY-MM-DD)."
    return deed(
        "consent", "consent", str(study.file), *study.dataset, fields=fields, hint=hint, refuses=refuses, first=first
    )


def _practice(study: Study) -> Deed:
    practice, tasks = study.practice, [one.id for one in study.protocol.tasks]
    who, task = practice.left or (labels(study.protocol)[-1], tasks[-1])
    often = practice.repetitions
    fields = (
        Field("Repetitions", "--repetitions", str(often or ""), wanted=False, check=a_count),
        Field("Task", "--task", task, wanted=False),
        Field("Participant", "--participant", who),
    )
    every = study.protocol.trials(study.protocol.task(task))
    hint = f"Repetitions of each stimulus or pair: {SHORT} for {study.short.trials(task)} trials; "
    hint += f"leave empty for all {every}. Tasks: {', '.join(tasks)}; leave empty for all. "
    hint += "Practice is never part of the study's data."
    lines = tuple(word for word in study.place.session if word == "--lines")
    does = f"Practice {practice.trials(task)} of {every} trials with a simulated participant."
    found = deed("practice", "run", str(study.file), "--practice", *lines, fields=fields, hint=hint)
    return replace(found, does=does) if often else found


def _session(study: Study, name: str) -> Deed:
    """Return what begins or resumes a session, with everything that prevents one."""
    people = study.status.those("to begin" if name == "begin" else "under way") if study.status else []
    who = people[0].participant if people else ""
    refuses = study.unsealed + study.unusable
    first = "seal" if study.unsealed else "rig" if study.place.rig is None else "doctor"
    if study.unfilled:
        first = "edit"
    if not who:
        nobody = "no enrolled participant is waiting for a session" if name == "begin" else "no visit is in progress"
        refuses, first = (*refuses, Finding(nobody)), first if refuses else "enrol" if name == "begin" else ""
    elif not refuses:
        refuses, first = as_findings(lambda: _prepare(study, who)), ""
    hint = f"{', '.join(one.participant for one in people)}. All files for {who} have been checked."
    fields = (Field("Participant", "--participant", who),)
    return deed(name, *study.run, fields=fields, hint=hint, refuses=refuses, first=first)


def _prepare(study: Study, who: str) -> None:
    """Make the checks of `palpate run` that open no device and ask nobody. Raises as they do."""
    silent = TerminalConsole(write=io.StringIO(), ask=input, heading="")
    recordings = study.place.recordings if study.recordings else None
    given = ("--rig", str(study.place.rig), *study.recordings, *study.place.session)
    run.prepare(study.file, study.place.rig or Path(), who, None, study.place.dataset, recordings, silent, given)


def _withdraw(study: Study) -> Deed:
    people = [one.participant for one in study.status.people if one.state != "withdrawn"] if study.status else []
    refuses = () if people else (Finding("nobody is enrolled"),)
    fields = (
        Field("Participant", "--participant"),
        Field("Reason", "--reason", "asked to stop"),
        Field("Erase data", "--erase", NO, flag=True),
    )
    hint = "Give a reason without names or health information. Before erasing, the desk asks for the label again."
    return deed(
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
    nothing = () if study.data else (Finding("no session has been run or practiced"),)
    given, first = str(study.data), "practice"
    shares: tuple[Finding, ...] = ()
    if study.protocol.sharing is None:
        shares = (Finding("the protocol has no [sharing] table, so nothing can be shared"),)
    elif study.data != study.root:
        shares = (Finding("no session of the study has been run"),)
    out = (Field("New folder", "", f"{study.root}-shared"),)
    return {
        "status": deed(
            "status",
            "status",
            str(study.root if study.status else study.data),
            refuses=() if study.status else nothing,
            first=first,
        ),
        "analyse": deed("analyse", "analyse", given, refuses=nothing, first=first),
        "verify": deed("verify", "verify", given, refuses=nothing, first=first),
        "share": deed("share", "share", given, fields=out, refuses=shares),
    }
