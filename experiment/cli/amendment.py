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


@commands.command(epilog="Example: palpate amend study.toml --halfway session --consent-anew everybody")
def amend(
    protocol_file: ProtocolFile,
    halfway: Annotated[
        Literal["old", "session", "new"] | None,
        typer.Option(
            "--halfway",
            help="Which version somebody halfway finishes: the old one for all tasks (old), the old one for the "
            "session under way and the new one for further tasks (session), or no trial of the old one (new).",
        ),
    ] = None,
    consent_anew: Annotated[
        Literal["everybody", "nobody"] | None,
        typer.Option("--consent-anew", help="Who of those who go on under the new version must consent to it first."),
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
        if {halfway, consent_anew, from_on, page_file} != {None}:
            what = "got --halfway, --consent-anew, --from or --html beside a suspension, its lift or an end"
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
    anew = None if consent_anew is None else consent_anew == "everybody"
    planned = amendment.plan_approval(protocol_file, root=root, from_on=from_on, halfway=halfway, consent_anew=anew)
    renewal = _show(protocol_file, root, page_file)
    if not renewal and (halfway is None or consent_anew is None):
        what = "this is an amendment, and the board decides how those halfway finish and who consents anew"
        raise RosterError(what, remedy="give --halfway and --consent-anew as its letter says")
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
    from palpate.experiment.protocol import files
    from palpate.experiment.protocol.page import changes
    from palpate.experiment.study import amendment

    root, _, known = amendment.known_approvals(protocol_file, root)
    old, new = amendment.latest(root, known), files.load(protocol_file)
    renewal = not changes.changes(old, new)
    if page_file is not None:
        if page_file.suffix != ".html":
            raise PalpateError(f"got the file {page_file}", allowed="a name that ends in .html")
        options.put_file(page_file, changes.html(old, new).encode())
    typer.echo("A renewal: no field of the protocol changes." if renewal else changes.text(old, new))
    return renewal


def _tell_consent(protocol_file: Path, root: Path, on: date) -> None:
    from palpate.experiment.study import amendment

    _, roster, known = amendment.known_approvals(protocol_file, root)
    if who := amendment.to_consent_anew(root, known, roster, on):
        typer.echo(f"Must consent anew before their next session: {', '.join(who)} (palpate consent)")


def _tell_anchor(root: Path) -> None:
    from palpate.experiment.dataset import checks

    typer.echo(f"For the lab book: {checks.keep_anchor(root)[0].line}")
