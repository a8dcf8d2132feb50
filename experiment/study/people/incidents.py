"""Puts adverse events and deviations on record: in the roster, without saying whom they happened to."""

from collections.abc import Iterable
from datetime import date
from pathlib import Path

from pydantic import ValidationError

from palpate.experiment import storage
from palpate.experiment.clock import day, wall_ns
from palpate.experiment.errors import RosterError
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.settings.load import VISIBLE
from palpate.experiment.study import people
from palpate.experiment.study.lines import Incident, IncidentKind, Informed, TookPart
from palpate.experiment.study.people import has_name
from palpate.experiment.study.roster import Roster


def report(
    protocol: Protocol,
    root: Path,
    kind: IncidentKind,
    *,
    what: str,
    done: str,
    happened_on: date | None = None,
    informed_on: date | None = None,
    took_part: TookPart | None = None,
) -> Incident:
    """Put an incident on record, on disk when this returns; without a day it happened today.

    Raises `RosterError` for a text that is no line or names a participant, for a day that is still to come.
    """
    roster = Roster.continued(storage.roster_path(root))
    today = roster.known_day(day(wall_ns()))
    names = [person.name for person in people.known(protocol, root).values()]
    for text in (what, done):
        check_names(text, names)
    try:
        incident = Incident(
            kind=kind,
            number=len(roster.incidents) + 1,
            happened_on=happened_on or today,
            what=what,
            done=done,
            informed_on=informed_on,
            took_part=took_part,
        )
    except ValidationError as error:
        what = "the description of the incident cannot be recorded"
        raise RosterError(what, allowed=f"one line of 1 to 400 characters, {VISIBLE}") from error
    check_days(incident.happened_on, informed_on, today)
    roster.append(Incident, **incident.model_dump())
    return incident


def inform(root: Path, number: int, informed_on: date) -> Incident:
    """Put on record that the board was informed of an incident, and return that. Raises `RosterError`."""
    roster = Roster.continued(storage.roster_path(root))
    for one in roster.incidents[number - 1 : number]:
        check_days(one.happened_on, informed_on, roster.known_day(day(wall_ns())))
    roster.append(Informed, number=number, informed_on=informed_on)
    return roster.incidents[number - 1]


def check_days(happened_on: date, informed_on: date | None, today: date) -> None:
    """Raise `RosterError` for an incident of a day to come, or one that the board heard of before it happened."""
    if happened_on > today:
        raise RosterError(f"got {happened_on} as the day of the incident", allowed=f"up to {today}")
    if informed_on is not None and not happened_on <= informed_on <= today:
        raise RosterError(f"got {informed_on} as the day the board was informed", allowed=f"{happened_on} to {today}")


def check_names(text: str, names: Iterable[str]) -> None:
    """Raise `RosterError`, without the text, if it has one of these `names`."""
    if has_name(text, names):
        raise RosterError(
            "got the name of a participant",
            remedy="the record is permanent, so use different words",
            allowed="one line without names",
        )
