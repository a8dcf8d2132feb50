"""The commands of what a board decides and has to be told, and of what leaves the laboratory."""

from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from palpate.experiment.cli import options
from palpate.experiment.cli.options import ProtocolFile, StudyFolder, a_day
from palpate.experiment.errors import DatasetError, PalpateError, Remedy, RosterError

if TYPE_CHECKING:
    from palpate.experiment.study.lines import IncidentKind, TookPart

commands = options.room()


def _day(name: str, text: str) -> object:
    return typer.Option(name, parser=a_day, metavar="YYYY-MM-DD", help=text)


@commands.command(epilog="Example: palpate amend study.toml --in-progress session --reconsent everybody")
def amend(
    protocol_file: ProtocolFile,
    in_progress: Annotated[
        Literal["old", "session", "new"] | None,
        typer.Option(
            "--in-progress",
            help="Version with which participants who have begun will finish: the old one for all tasks (old), the "
            "old one for the current session and the new one for later tasks (session), or only the new one (new), "
            "which ends sessions in progress: their remaining trials are never run.",
        ),
    ] = None,
    reconsent: Annotated[
        Literal["everybody", "nobody"] | None,
        typer.Option(
            "--reconsent", help="Whether participants who continue under the new version must consent to it first."
        ),
    ] = None,
    from_on: Annotated[date | None, _day("--from", "First day of the approval [default: today].")] = None,
    suspended_on: Annotated[date | None, _day("--suspended-on", "The board suspends the study from this day.")] = None,
    lifted_on: Annotated[date | None, _day("--lifted-on", "The board lifts the suspension on this day.")] = None,
    ended_on: Annotated[date | None, _day("--ended-on", "The board ends the study on this day.")] = None,
    reason: Annotated[
        str | None,
        typer.Option("--reason", help="Reason for suspending, resuming or ending the study: one line, no names."),
    ] = None,
    page_file: Annotated[
        Path | None, typer.Option("--html", metavar="FILE.html", help="Write the list of changes as HTML.")
    ] = None,
    dataset: StudyFolder = None,
    yes: Annotated[
        bool, typer.Option("--yes", help="Record without asking for confirmation, e.g., in a script.")
    ] = False,
) -> None:
    """Record a study's amendment, renewal, suspension or end.

    When the board has approved a new version, or renewed the same one, seal it next to its file (`palpate seal
    --replace`), then run this command. It shows old and new side by side and asks before it records anything. The
    dataset stores all versions and seals. Labels and orders of tasks do not change. `palpate run` then allows each
    participant only the version that covers them.

    With --suspended-on, --lifted-on or --ended-on, and --reason, the command records that the board suspended the
    study, lifted the suspension, or ended the study. While a study is suspended, nobody can be run or enrolled.
    After its end, nobody ever can. The end cannot be undone, so the command asks before recording it.
    """
    from palpate.experiment.dataset import checks
    from palpate.experiment.study import amendment, enrolment

    root = enrolment.study_begun(protocol_file, dataset)
    checks.check_roster(root)
    stops = {"suspended": suspended_on, "lifted": lifted_on, "ended": ended_on}
    given = [(kind, on) for kind, on in stops.items() if on is not None]
    if (len(given), reason is None) not in ((0, True), (1, False)):
        what = "give one of --suspended-on, --lifted-on, --ended-on with --reason, or none of them"
        raise RosterError(what)
    if given:
        if {in_progress, reconsent, from_on, page_file} != {None}:
            what = "got --in-progress, --reconsent, --from or --html with --suspended-on, --lifted-on or --ended-on"
            raise RosterError(what, remedy="leave them out: they apply to an amendment or a renewal")
        ((kind, on),) = given
        if kind != "suspended":
            checks.load_sound(root)
        if kind == "ended" and not yes:
            asked = f"This permanently ends the study as of {on}: no more sessions can run. It cannot be undone."
            options.confirm(asked, "end", "nothing was recorded")
        words = {"suspended": "suspended", "lifted": "no longer suspended", "ended": "ended"}[kind]
        path = amendment.stop(protocol_file, kind, on, reason or "", root=root)  # type: ignore[arg-type]
        typer.echo(f"The study is {words} as of {on}: {path}")
        if kind == "suspended" and (lifted := amendment.lifted_after(path, on)) is not None:
            typer.echo(
                f"BUT: the roster already has a lift from {lifted}, which ends this suspension. If the board suspended "
                "the study again later, record that with the day of the new decision."
            )
        _follow_up(root)
        return
    checks.load_sound(root)
    again = None if reconsent is None else reconsent == "everybody"
    planned = amendment.plan_approval(
        protocol_file, root=root, from_on=from_on, in_progress=in_progress, reconsent=again
    )
    renewal = _show(protocol_file, root, page_file)
    if not renewal and (in_progress is None or reconsent is None):
        what = (
            "this is an amendment: the board decides how participants who have begun will finish, and who must consent "
            "again"
        )
        words = "choose as in the board's letter (old, session or new; everybody or nobody): {}"
        chosen = ("--in-progress", in_progress or "WHICH", "--reconsent", reconsent or "WHO", "--dataset", str(root))
        command = ("palpate", "amend", str(protocol_file), *chosen)
        raise RosterError(what, remedy=Remedy(words, command, suffices=False))
    noun = "renewal" if renewal else "amendment"
    if not yes:
        asked = f"This records the {noun} as approval {planned.number}, from {planned.from_on} to {planned.expires_on}."
        options.confirm(asked, "amend", "nothing was recorded")
    kept = amendment.record(protocol_file, planned, root=root)
    typer.echo(f"The {noun} is approval {planned.number}, from {planned.from_on} to {planned.expires_on}: {kept}")
    _tell_consent(protocol_file, root, planned.from_on)
    _follow_up(root)


def _show(protocol_file: Path, root: Path, page_file: Path | None) -> bool:
    """Show old and new side by side; return whether nothing differs, as in a renewal."""
    from palpate.experiment.protocol import approval, files
    from palpate.experiment.protocol.page import changes
    from palpate.experiment.study import amendment

    root, roster, known = amendment.known_approvals(protocol_file, root)
    incidents = [one.sentence for one in roster.incidents]
    old, new = amendment.latest(root, known), files.load(protocol_file)
    renewed = known.version_of(approval.sha256(new))
    if page_file is not None:
        if page_file.suffix != ".html":
            raise PalpateError(f"got the file {page_file}", allowed="a name that ends in .html")
        shown = new if renewed else old
        options.put_file(page_file, changes.html(shown, new, incidents).encode())
    if renewed is None:
        typer.echo(changes.text(old, new))
    elif renewed == known.version_on(date.max):
        typer.echo("A renewal: no fields of the protocol change.")
    else:
        typer.echo(f"A renewal of approval {renewed}, only for participants who continue under its version.")
    typer.echo("\n".join(["Adverse events and deviations:", *(incidents or ["none recorded"])]))
    return renewed is not None


def _tell_consent(protocol_file: Path, root: Path, on: date) -> None:
    from palpate.experiment.study import amendment

    _, roster, known = amendment.known_approvals(protocol_file, root)
    if who := amendment.to_reconsent(root, known, roster, on):
        typer.echo(f"Participants who must consent again before their next session (palpate consent): {', '.join(who)}")


@commands.command(epilog="Example: palpate incident study.toml --adverse 'a fall' --done 'the session was ended' -p 03")
def incident(
    protocol_file: ProtocolFile,
    adverse: Annotated[str | None, typer.Option("--adverse", help="Record an adverse event: what happened.")] = None,
    deviation: Annotated[
        str | None, typer.Option("--deviation", help="Record a deviation from the protocol: what happened.")
    ] = None,
    done: Annotated[str | None, typer.Option("--done", help="What was done.")] = None,
    on: Annotated[date | None, _day("--on", "The day on which it happened [default: today].")] = None,
    informed_on: Annotated[date | None, _day("--informed-on", "The day on which the board was informed.")] = None,
    number: Annotated[
        int | None,
        typer.Option("--number", min=1, help="Number of an incident of which the board has now been informed."),
    ] = None,
    participant: Annotated[
        str | None,
        typer.Option(
            "--participant",
            "-p",
            help="Participant whose latest session gets a note; the incident itself does not contain the label.",
        ),
    ] = None,
    person: Annotated[
        str | None,
        typer.Option(
            "--took-part",
            metavar="TASK=LABEL",
            help="Person who actually took part in that task, recorded under --participant.",
        ),
    ] = None,
    exchanged: Annotated[
        bool,
        typer.Option(
            "--exchanged", help="With --took-part: the two participants did that task under each other's labels."
        ),
    ] = False,
    dataset: StudyFolder = None,
) -> None:
    """Record an adverse event or a deviation from the protocol.

    Without options, the command lists all of them. Each is one permanent line of the roster: what happened and
    when, what was done, and when the board was informed. It contains no label. With --participant, the journal of
    their latest session notes the number; the note is erased with their data. During a session, use the console
    instead. `palpate status`, `palpate amend` and the report list all incidents.

    A session under the wrong label is a deviation: use --participant (its label) and --took-part (its task, and the
    label of the person who took part). The session keeps its label and order. The analysis counts it for the person
    who really took part, and reports this. If the other person then lacks that task, withdraw their label (`palpate
    withdraw`), enroll them again (`palpate enrol`), and move their own sessions to the new label with --took-part.
    """
    from palpate.experiment import storage
    from palpate.experiment.dataset import checks
    from palpate.experiment.protocol import files
    from palpate.experiment.study import enrolment
    from palpate.experiment.study.people import incidents
    from palpate.experiment.study.roster import Roster

    root = enrolment.study_begun(protocol_file, dataset)
    checks.check_roster(root)
    took_part = _took_part(root, (participant, deviation, person), exchanged=exchanged)
    told = [what for what in (adverse, deviation) if what is not None]
    given = (len(told), done is not None, number is not None, informed_on is not None)
    if given == (0, False, False, False):
        known = Roster.load(storage.roster_path(root)).incidents
        typer.echo("\n".join(one.sentence for one in known) or "No incidents are recorded.")
        return
    if number is not None and informed_on is not None and given[:2] == (0, False):
        typer.echo(incidents.inform(root, number, informed_on).sentence)
    elif len(told) == 1 and done is not None and number is None:
        if participant is not None:
            Roster.load(storage.roster_path(root)).check_enrolled(participant)
        kind: IncidentKind = "adverse event" if adverse is not None else "deviation"
        protocol = files.load(protocol_file)
        made = incidents.report(
            protocol, root, kind, what=told[0], done=done, happened_on=on, informed_on=informed_on, took_part=took_part
        )
        typer.echo(made.sentence)
        if participant is not None:
            text = f"{made.kind.capitalize()} {made.number} is in the roster."
            _note_incident(root, protocol_file, participant, took_part, text)
    else:
        what = "give --adverse or --deviation with --done, or --number with --informed-on, or none of them"
        raise RosterError(what)
    _follow_up(root)


def _took_part(root: Path, given: tuple[str | None, str | None, str | None], *, exchanged: bool) -> "TookPart | None":
    from palpate.experiment import storage
    from palpate.experiment.study import lines
    from palpate.experiment.study.people import labels
    from palpate.experiment.study.roster import Roster

    participant, deviation, told = given
    if told is None and not exchanged:
        return None
    task, _, person = (told or "").partition("=")
    if participant is None or deviation is None or not person:
        what = "give --took-part TASK=LABEL with --deviation, and with --participant for the label of the session"
        raise RosterError(what)
    made = lines.TookPart(participant=participant, task=task, person=person, exchanged=exchanged)
    labels.check_took_part(Roster.load(storage.roster_path(root)), root, made)
    return made


def _note_incident(root: Path, protocol_file: Path, participant: str, took_part: "TookPart | None", text: str) -> None:
    """Put a note into the journal of somebody's latest session, or of the one under a wrong label."""
    from palpate.experiment import storage
    from palpate.experiment.clock import MonotonicClock
    from palpate.experiment.desk.messages import TakeNote
    from palpate.experiment.protocol import files
    from palpate.experiment.session import remarks
    from palpate.experiment.study import enrolment, roster, schedule

    task = None if took_part is None else took_part.task
    participant = participant if took_part is None else took_part.person
    takes = roster.Roster.load(storage.roster_path(root)).takes
    allocated = schedule.allocated(files.load(protocol_file), enrolment.seed_of(root), takes)
    tasks = schedule.find_allocation(allocated, participant).tasks
    try:
        session = remarks.paused(root, participant, tasks[:-1], task or tasks[-1], MonotonicClock())
        told = session.remark(TakeNote(text=text)) if session is not None else (False, "")
    except PalpateError as error:
        # The incident is on record: an error here would have it recorded again.
        told = (False, "")
        options.say(error.sentence())
    which = "that session" if task else "their latest session"
    typer.echo(f"A note was added to the journal of {which}." if told[0] else "No note was added to a journal.")


def _follow_up(root: Path) -> None:
    """Make tables and anchor after a line of the roster; that line stays on record if they cannot be made."""
    from palpate.experiment import storage
    from palpate.experiment.dataset import build

    try:
        if storage.journals(root):
            build.build(root)
        _tell_anchor(root)
    except PalpateError as error:
        what = "the entry is in the roster, so do not record it again, but the tables and the anchor were not made"
        mend = Remedy("solve that problem, then run {}", ("palpate", "build", str(root)), suffices=False)
        raise error.followed_by(DatasetError(root, what, mend)) from error


def _tell_anchor(root: Path) -> None:
    from palpate.experiment.dataset import checks

    typer.echo(f"For the lab book: {checks.keep_anchor(root)[0].line}")


@commands.command(epilog="Example: palpate share participants/study study-shared")
def share(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Folder of a study's dataset.")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder of the copy; it must not exist yet.")],
) -> None:
    """Write a copy of a dataset to share, containing only participants who agreed.

    Participants agree with `palpate consent --sharing`, and the protocol must have a [sharing] table. Labels are
    new and random, and times count from the beginning of each session. Journals, voice recordings, session dates,
    notes and typed reasons are left out, and so are stimuli without a file stimuli/LICENSE. The command prints the
    size of the smallest group of participants with the same first task, group and version. It refuses a group
    smaller than the protocol allows. The copy is a BIDS derivative that `palpate verify` and `palpate analyse` can
    read.
    """
    from palpate.experiment import storage
    from palpate.experiment.dataset.outside import sharing

    made = sharing.share(dataset, out)
    for sentence in made.sentences():
        options.say(sentence)
    typer.echo(f"Shared: {made.root}")
    if storage.roster_path(dataset).exists():
        _tell_anchor(dataset)
