"""Lines of the roster that name nobody, or nobody by more than a label: adverse events, and deviations."""

from datetime import date
from typing import Annotated, Literal

from pydantic import Field

from palpate.experiment.records.entries import Entry
from palpate.experiment.settings.load import Line

IncidentKind = Literal["adverse event", "deviation"]


class Incident(Entry):
    """An adverse event, or a deviation from the protocol: what happened when, what was done, when the board was told.

    To whom it happened stands in no line of the roster, for these stay whoever is erased; the journal of a session has
    a note with its number.
    """

    kind: IncidentKind
    number: Annotated[int, Field(ge=1)]
    happened_on: date
    what: Annotated[Line, Field(max_length=400)]
    done: Annotated[Line, Field(max_length=400)]
    informed_on: date | None = None

    @property
    def sentence(self) -> str:
        """All of it in words."""
        board = f"board informed on {self.informed_on}" if self.informed_on else "the board is not informed yet"
        return f"{self.kind.capitalize()} {self.number}, {self.happened_on}: {self.what} Done: {self.done} ({board})"


class Informed(Entry):
    """The board was informed of an incident that was on record before."""

    kind: Literal["informed"] = "informed"
    number: Annotated[int, Field(ge=1)]
    informed_on: date
