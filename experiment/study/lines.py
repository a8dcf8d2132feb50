"""Lines of the roster beside enrolment and consent: adverse events and deviations, and who meets the criteria."""

import hashlib
from collections.abc import Iterable
from datetime import date
from typing import Annotated, Literal

from pydantic import BaseModel, Field

from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records.entries import Entry
from palpate.experiment.settings.load import Line

IncidentKind = Literal["adverse event", "deviation"]


class TookPart(BaseModel, frozen=True, extra="forbid"):
    """Who took part in a session under another participant's label; `exchanged`: and that one under theirs."""

    participant: str
    task: str
    person: str
    exchanged: bool = False

    @property
    def people(self) -> dict[tuple[str, str], str]:
        """The person of each session, which its label and its task name."""
        own = {(self.participant, self.task): self.person}
        return own | ({(self.person, self.task): self.participant} if self.exchanged else {})


class Incident(Entry):
    """An adverse event, or a deviation from the protocol: what happened when, what was done, when the board was told.

    To whom it happened stands in no line of the roster, for these stay whoever is erased; the journal of a session has
    a note with its number. `took_part` has the labels of a session under a wrong one.
    """

    kind: IncidentKind
    number: Annotated[int, Field(ge=1)]
    happened_on: date
    what: Annotated[Line, Field(max_length=400)]
    done: Annotated[Line, Field(max_length=400)]
    informed_on: date | None = None
    took_part: TookPart | None = None

    @property
    def sentence(self) -> str:
        """All of it in words."""
        board = f"board informed on {self.informed_on}" if self.informed_on else "board not yet informed"
        what = f"{self.what.rstrip('.')}. Done: {self.done}"
        return f"{self.kind.capitalize()} {self.number}, {self.happened_on}: {what} ({board})"


class Eligible(Entry):
    """A participant meets every criterion, each confirmed by itself; whoever does not has no such line.

    The hash is that of the criteria, as `criteria_sha256` has it: others are confirmed anew.
    """

    kind: Literal["eligible"] = "eligible"
    participant: str
    criteria: Annotated[int, Field(ge=1)]
    criteria_sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    confirmed_on: date


def criteria_sha256(criteria: Iterable[str]) -> str:
    """Return the SHA-256 of these criteria, one a line, 64 hexadecimal digits."""
    return hashlib.sha256("\n".join(" ".join(one.split()) for one in criteria).encode()).hexdigest()


def sharing_sha256(protocol: Protocol) -> str:
    """Return the SHA-256 of what participants are asked to share, 64 hexadecimal digits; empty for nothing.

    Beside the table `[sharing]` these are the facts and the questionnaires that it names, as they are asked, and
    `[[asked.touch]]`.
    """
    if (rule := protocol.sharing) is None:
        return ""
    shared: list[BaseModel] = [rule]
    for asked, names in (("people", rule.facts), ("questionnaires", rule.questionnaires)):
        shared += [one for one in getattr(getattr(protocol, "asked", None), asked, ()) if one.id in names]
    shared += getattr(getattr(protocol, "asked", None), "touch", ()) if "touch" in rule.questionnaires else ()
    text = "".join(one.model_dump_json(exclude_defaults=True) for one in shared)
    return hashlib.sha256(text.encode()).hexdigest()


class Facts(Entry):
    """A participant answered what the protocol asks of them; the last such line holds.

    The hash is that of the file of their answers, which has its salt: once that is deleted it tells nothing.
    """

    kind: Literal["facts"] = "facts"
    participant: str
    file_sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class Informed(Entry):
    """The board was informed of an incident that was on record before."""

    kind: Literal["informed"] = "informed"
    number: Annotated[int, Field(ge=1)]
    informed_on: date
