"""The desk's first page: what can be done, what cannot and why, and what its keys do."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion
from textual.pilot import Pilot

from palpate.experiment.desk.console.home import Chosen, Deed, Field, HomePage, Scene
from palpate.experiment.errors import DatasetError, Finding, PalpateError
from tests.experiment.desk.console.test_study import STUDY


def day(text: str) -> None:
    if text != "2026-05-04":
        raise PalpateError("got no day")


SCENE = Scene(
    heading="steps · Steps on sand and snow",
    facts=(("Protocol", "study.toml. Sealed until 2027-01-01, approval number 7."), ("Rig", "none chosen")),
    deeds=(
        Deed("check", "Show the protocol.", ("palpate", "check", "study.toml")),
        Deed("rig", "Choose the rig file.", ("rig",), (Field("Rig file", "", "rig.toml"),)),
        Deed(
            "enrol",
            "Enrol the next participant.",
            ("palpate", "enrol", "study.toml"),
            (
                Field("Participant", "--participant", "05"),
                Field("Consent on", "--consent-on", wanted=False, check=day),
                Field("Erase", "--erase", "no", flag=True),
            ),
            "The day on which they signed.",
        ),
        Deed(
            "begin",
            "Begin a visit.",
            ("palpate", "run"),
            refuses=(Finding("no rig file is chosen"), Finding("nobody waits", Path("roster.jsonl"))),
            first="rig",
        ),
    ),
    next="enrol",
    status=STUDY,
    parts=("rig", "begin"),
)


def text(app: HomePage) -> str:
    return "\n".join(strip.text.rstrip() for strip in app.screen._compositor.render_strips()) + "\n"


@dataclass
class Shown:
    """What a page showed after some keys, and how it ended."""

    text: str
    chosen: Chosen | None


def shown(
    *keys: str, wanted: str = "", size: tuple[int, int] = (80, 24), read: Callable[[], Scene] = lambda: SCENE
) -> Shown:
    """Return what is shown once `wanted` is on the page after the keys, or, without any, once it has ended."""

    async def act() -> Shown:
        app = HomePage(read, "Welcome back.")
        async with app.run_test(size=size) as pilot:
            await until(pilot, lambda: "Reading the study" not in text(app) or "cannot" in text(app))
            await pilot.press(*keys)
            if wanted:
                await until(pilot, lambda: wanted in text(app))
            await pilot.pause()
            seen = text(app) if wanted else ""
        return Shown(seen, app.return_value)

    return asyncio.run(act())


async def until(pilot: Pilot[Chosen], happened: Callable[[], bool]) -> None:
    async with asyncio.timeout(20):
        while not happened():
            await pilot.pause()


@pytest.mark.parametrize("size", [(80, 24), (120, 36)])
def test_what_can_be_done_is_listed_and_the_rest_has_its_reason(
    size: tuple[int, int], approved: SnapshotAssertion
) -> None:
    assert shown("b", wanted="First: rig", size=size).text == approved


@pytest.mark.parametrize("size", [(80, 24), (120, 36)])
def test_what_a_command_needs_is_asked_for(size: tuple[int, int], approved: SnapshotAssertion) -> None:
    assert shown("enter", wanted="Esc", size=size).text == approved


def test_what_comes_next_is_chosen_and_each_field_gives_its_part_of_the_command() -> None:
    # What is typed goes to the first field that is empty.
    chosen = shown("enter", *"2026-05-04", "shift+tab", *"07", "enter").chosen
    line = ("palpate", "enrol", "study.toml", "--participant", "07", "--consent-on", "2026-05-04")
    assert chosen == Chosen("enrol", line)
    assert shown("enter", "tab", *"yes", "enter").chosen == Chosen("enrol", (*line[:4], "05", "--erase"))
    assert shown("c", "enter").chosen == Chosen("check", ("palpate", "check", "study.toml"))
    assert shown("f9").chosen is None


def test_a_form_has_room_for_the_fields_of_an_incident() -> None:
    fields = tuple(Field(f"Field {number}", f"--f{number}", str(number)) for number in range(8))
    many = replace(SCENE, deeds=(Deed("incident", "Record one.", ("incident",), fields),), next="incident")
    chosen = shown("enter", "enter", read=lambda: many).chosen
    assert chosen is not None
    assert chosen.arguments[-2:] == ("--f7", "7")


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (("shift+tab", "backspace", "tab", "enter"), "Participant is empty."),
        (("x", "enter"), "got no day"),
        (("tab", "x", "enter"), "Erase: type yes or no."),
    ],
)
def test_a_field_that_no_command_would_take_is_refused_in_the_form(keys: tuple[str, ...], words: str) -> None:
    assert shown("enter", *keys, wanted=words).chosen is None


def test_a_form_is_closed_and_nothing_is_done() -> None:
    closed = shown("enter", "escape", wanted="palpate enrol study.toml")
    assert closed.chosen is None
    assert "Esc" not in closed.text


def test_from_what_is_not_possible_enter_goes_to_what_leads_there() -> None:
    there = shown("b", "enter", wanted="Choose the rig file.")
    assert "▸●  rig" in there.text
    assert there.chosen is None
    nowhere = replace(SCENE, deeds=(replace(SCENE.deeds[-1], first=""),), next="begin")
    assert shown("enter", wanted="✗", read=lambda: nowhere).chosen is None


def test_keys_and_clicks_choose() -> None:
    assert "▸●  rig" in shown("up", "up", "up", "down", wanted="rig").text

    async def act() -> Chosen | None:
        app = HomePage(lambda: SCENE)
        async with app.run_test(size=(80, 24)) as pilot:
            await until(pilot, lambda: "enrol" in text(app))
            row = next(number for number, line in enumerate(text(app).splitlines()) if "check" in line)
            await pilot.click(offset=(20, row))
            await until(pilot, lambda: "▸●  check" in text(app))
            await pilot.click(offset=(20, row))
        return app.return_value

    assert asyncio.run(act()) == Chosen("check", ("palpate", "check", "study.toml"))


@pytest.mark.parametrize("error", [DatasetError("the roster cannot be read"), ValueError("cannot be parted")])
def test_a_study_that_cannot_be_read_is_told_and_read_again(error: Exception) -> None:
    found: list[Scene] = []

    def read() -> Scene:
        if not found:
            found.append(SCENE)
            raise error
        return found[0]

    shown(wanted="cannot be", read=read)
    found.clear()
    assert "cannot be" not in shown("f5", wanted="Steps on sand", read=read).text


def test_a_form_shows_the_whole_name_of_each_field() -> None:
    name = "Number of the board's letter"
    seal = Deed("seal", "Record the approval.", ("palpate", "seal"), (Field("Day", "--on"), Field(name, "--number")))
    there = shown("s", "enter", wanted="Day", read=lambda: replace(SCENE, deeds=(*SCENE.deeds, seal))).text
    assert name in there
