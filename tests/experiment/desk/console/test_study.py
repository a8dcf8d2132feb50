"""The desk's first page, at 80 x 24: what it shows of a study, and what its keys do."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path

import pytest
from textual.pilot import Pilot

from palpate.experiment.dataset.status import Person, Status
from palpate.experiment.desk.console.study import StudyPage
from palpate.experiment.errors import DatasetError, Finding

STUDY = Status(
    root=Path("study"),
    day=date(2026, 5, 4),
    study="steps",
    title="Steps on sand and snow",
    purpose="STUDY",
    seal="Sealed until 2027-01-01, approval number 7.",
    planned=4,
    people=(
        Person("01", ("virtual", "real"), "done", ()),
        Person("02", ("real", "virtual"), "withdrawn", ()),
        Person("03", ("virtual", "real"), "to begin", ()),
        Person("04", ("real", "virtual"), "doubted", ()),
    ),
    erased=frozenset(),
    revealed={},
    to_enrol="05",
    doubts=(Finding("cut", "sub-04"),),
    reminders=(Finding("Make room."),),
)


@dataclass
class Shelf:
    """What is read, and how often it was."""

    found: Status | DatasetError | OSError = STUDY
    times: int = field(default=0)

    def read(self) -> Status:
        self.times += 1
        if isinstance(self.found, DatasetError | OSError):
            raise self.found
        return self.found


def text(app: StudyPage) -> str:
    return "\n".join(strip.text.rstrip() for strip in app.screen._compositor.render_strips())


async def until(pilot: Pilot[str], app: StudyPage, happened: Callable[[str], bool]) -> str:
    """Return the screen once something is on it."""
    async with asyncio.timeout(20):
        while not happened(text(app)):
            await pilot.pause()
    return text(app)


def shown(shelf: Shelf, *keys: str, wanted: str, refuses: str = "") -> tuple[str, str | None]:
    """Return the screen once it has `wanted` on it after some keys, and how the page ended."""

    async def act() -> tuple[str, str | None]:
        app = StudyPage(shelf.read, refuses=refuses)
        async with app.run_test(size=(80, 24)) as pilot:
            await until(pilot, app, lambda seen: "Reading the study" not in seen or "cannot" in seen)
            await pilot.press(*keys)
            seen = "" if wanted == "ENDED" else await until(pilot, app, lambda seen: wanted in seen)
        return seen, app.return_value

    return asyncio.run(act())


def test_it_says_how_far_the_study_is_and_what_comes_next() -> None:
    seen, _ = shown(Shelf(), wanted="done of 4 planned, 4 enrolled")
    told = " ".join(seen.split())
    for words in ("steps · Steps on sand and snow", "1 to begin", "1 withdrawn", "1 doubted", "0 excluded"):
        assert words in told
    for words in ("PROBLEMS IN THE DATA", "sub-04: cut", "03, task 1 of 2", "05 is next to enroll", "Make room."):
        assert words in told
    # The order of tasks is concealed before a session.
    assert "virtual" not in told


def test_enter_begins_the_session_of_whoever_comes_next_and_of_nobody_who_is_done() -> None:
    assert shown(Shelf(), "enter", wanted="ENDED")[1] == "03"
    refused, ended = shown(Shelf(), "up", "up", "enter", wanted="There is no session for this participant to begin")
    assert "Participant 01: done." in refused
    assert ended is None
    assert shown(Shelf(), "f9", wanted="ENDED")[1] is None


def test_a_page_that_only_shows_says_what_is_missing() -> None:
    seen, ended = shown(Shelf(), "enter", wanted="Give a rig.", refuses="Give a rig.")
    assert "03" in seen
    assert ended is None


def test_a_key_shows_the_flow_of_participants() -> None:
    seen, _ = shown(Shelf(), "f", wanted="Enrolled: n = 4")
    assert "withdrew before beginning: 1" in seen


@pytest.mark.parametrize("error", [DatasetError("the roster cannot be read"), OSError("the roster cannot be read")])
def test_a_study_that_cannot_be_read_is_told_and_read_again(error: DatasetError | OSError) -> None:
    shelf = Shelf(found=error)

    async def act() -> str:
        app = StudyPage(shelf.read, refuses="")
        async with app.run_test(size=(80, 24)) as pilot:
            await until(pilot, app, lambda seen: "the roster cannot be read" in seen)
            shelf.found = replace(STUDY, doubts=())
            await pilot.press("r")
            return await until(pilot, app, lambda seen: "4 enrolled" in seen)

    assert "cannot be read" not in asyncio.run(act())
