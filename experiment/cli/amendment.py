"""The command that records what a board decided while a study runs."""

from datetime import date
from pathlib import Path
from typing import Annotated, Literal

import typer

from palpate.experiment.cli import options
from palpate.experiment.cli.options import ProtocolFile, StudyFolder, a_day
from palpate.experiment.errors import PalpateError, RosterError

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
            help="Which version somebody who has begun finishes: the old one for all tasks (old), the old one for the "
            "session under way and the new one for further tasks (session), or no trial of the old one (new).",
        ),
    ] = None,
    reconsent: Annotated[
        Literal["everybody", "nobody"] | None,
        typer.Option("--reconsent", help="Who of those who go on under the new version must consent to it first."),
    ] = None,
    from_on: Annotated[date | None, _day("--from", "First day of the approval [default: today].")] = None,
    suspended_on: Annotated[date | None, _day("--suspended-on", "The board suspends the study from this day.")] = None,
    lifted_on: Annotated[date | None, _day("--lifted-on", "The board lifts the suspension on this day.")] = None,
    ended_on: Annotated[date | None, _day("--ended-on", "The board ends the study on this day.")] = None,
    reason: Annotated[
        str | None, typer.Option("--reason", help="Why it is suspended, lifted or ended: one line, no names.")
    ] = None,
    page_file: Annotated[
        Path | None, typer.Option("--html", metavar="FILE.html", help="Write the page of changes as HTML.")
    ] = None,
    dataset: StudyFolder = None,
    yes: Annotated[bool, typer.Option("--yes", help="Record it without being asked, as in a script.")] = False,
) -> None:
    """Record an amendment, a renewal or a suspension of a study, or its end.

    The board approved another version, or the same one for longer: seal it beside its file (`palpate seal --replace`),
    then run this command. It shows old and new side by side and asks before it records anything. The dataset keeps all
    versions and seals, labels and orders of tasks stay as drawn, and `palpate run` then allows each participant only
    the version that covers them.

    With --suspended-on, --lifted-on or --ended-on, and --reason, it records that the board suspended the study, lifted
    the suspension, or ended the study. Nobody is run or enrolled while it is suspended, and never after its end, which
    cannot be undone: the command asks before it records that.
    """
    from palpate.experiment import storage
    from palpate.experiment.dataset import build, checks
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
            what = "got --in-progress, --reconsent, --from or --html beside a suspension, its lift or an end"
            raise RosterError(what, remedy="leave them out: they are of an amendment or a renewal")
        ((kind, on),) = given
        if kind == "ended" and not yes:
            asked = f"This ends the study from {on} on, for good: no session is run, and nothing lifts it."
            options.confirm(asked, "end", "nothing was recorded")
        words = {"suspended": "suspended", "lifted": "no longer suspended", "ended": "ended"}[kind]
        path = amendment.stop(protocol_file, kind, on, reason or "", root=root)  # type: ignore[arg-type]
        typer.echo(f"The study is {words} from {on} on: {path}")
        _tell_anchor(root)
        return
    again = None if reconsent is None else reconsent == "everybody"
    planned = amendment.plan_approval(
        protocol_file, root=root, from_on=from_on, in_progress=in_progress, reconsent=again
    )
    renewal = _show(protocol_file, root, page_file)
    if not renewal and (in_progress is None or reconsent is None):
        what = "this is an amendment, and the board decides how those who have begun finish and who consents again"
        raise RosterError(what, remedy="give --in-progress and --reconsent as its letter says")
    noun = "renewal" if renewal else "amendment"
    if not yes:
        asked = f"This records the {noun} as approval {planned.number}, from {planned.from_on} to {planned.expires_on}."
        options.confirm(asked, "amend", "nothing was recorded")
    kept = amendment.record(protocol_file, planned, root=root)
    typer.echo(f"The {noun} is approval {planned.number}, from {planned.from_on} to {planned.expires_on}: {kept}")
    if storage.journals(root):
        build.build(root)
    _tell_consent(protocol_file, root, planned.from_on)
    _tell_anchor(root)


def _show(protocol_file: Path, root: Path, page_file: Path | None) -> bool:
    """Show old and new side by side; return whether nothing differs, as in a renewal."""
    from palpate.experiment.protocol import approval, files
    from palpate.experiment.protocol.page import changes
    from palpate.experiment.study import amendment

    root, _, known = amendment.known_approvals(protocol_file, root)
    old, new = amendment.latest(root, known), files.load(protocol_file)
    renewed = known.version_of(approval.sha256(new))
    if page_file is not None:
        if page_file.suffix != ".html":
            raise PalpateError(f"got the file {page_file}", allowed="a name that ends in .html")
        shown = new if renewed else old
        options.put_file(page_file, changes.html(shown, new).encode())
    if renewed is None:
        typer.echo(changes.text(old, new))
    elif renewed == known.version_on(date.max):
        typer.echo("A renewal: no field of the protocol changes.")
    else:
        typer.echo(f"A renewal of the version of approval {renewed}, for those alone who go on under it.")
    return renewed is not None


def _tell_consent(protocol_file: Path, root: Path, on: date) -> None:
    from palpate.experiment.study import amendment

    _, roster, known = amendment.known_approvals(protocol_file, root)
    if who := amendment.to_reconsent(root, known, roster, on):
        typer.echo(f"Must consent again before their next session: {', '.join(who)} (palpate consent)")


def _tell_anchor(root: Path) -> None:
    from palpate.experiment.dataset import checks

    typer.echo(f"For the lab book: {checks.keep_anchor(root)[0].line}")
