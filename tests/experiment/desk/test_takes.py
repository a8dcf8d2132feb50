"""The experimenter's screen while takes are recorded: what it shows, and which keys it takes."""

from __future__ import annotations

import io

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus.panel.accelerometer import Window
from palpate.experiment.desk.questions import Rest
from palpate.experiment.desk.terminal import TerminalConsole, TerminalTakes
from palpate.experiment.recordings.store import Condition
from palpate.experiment.recordings.workflow import Step

CONDITION = Condition("copy paper", 100.0, 2)
WINDOW = Window(np.zeros(4), clipped=0)


class Keys:
    """Answers prompts with typed lines; every line must be used."""

    def __init__(self, *lines: str) -> None:
        self.lines = list(lines)
        self.prompts: list[str] = []

    def __call__(self, prompt: str) -> str:
        self.prompts.append(prompt)
        return self.lines.pop(0)


def screen(*lines: str) -> tuple[TerminalTakes, Keys, io.StringIO]:
    keys, written = Keys(*lines), io.StringIO()
    return TerminalTakes(write=written, ask=keys), keys, written


@pytest.mark.parametrize(
    ("achieved", "shown"),
    [
        (104.0, "The speed was 104 mm/s; the target is 100 mm/s (+4.0%): within 10%."),
        (88.0, "The speed was 88 mm/s; the target is 100 mm/s (-12.0%): the speed is off by -12%, more than 10%."),
    ],
)
def test_the_achieved_speed_stands_beside_its_target(achieved: float, shown: str) -> None:
    # A take off its target is kept only by a second key.
    console, keys, written = screen("k", *(["k"] if "off" in shown else []))
    assert console.keeps(Step(CONDITION, achieved, WINDOW))
    assert written.getvalue() == shown + "\n"
    assert keys.lines == []


def test_a_knock_that_was_left_out_is_told_of(approved: SnapshotAssertion) -> None:
    console, _, written = screen("k", "")
    console.keeps(Step(CONDITION, 100.0, WINDOW, knock_ms=412.3))
    console.keeps(Step(CONDITION, 100.0, None, knock_ms=412.3))
    assert written.getvalue() == approved


def test_a_take_with_problems_can_be_repeated_at_the_second_question() -> None:
    console, keys, _ = screen("k", "r", "")
    assert not console.keeps(Step(CONDITION, 88.0, WINDOW))
    assert keys.prompts[-1].startswith(f"Lay out a fresh {CONDITION.material}, then press Enter")
    assert keys.lines == []


def test_repeat_waits_until_the_panel_is_ready_again() -> None:
    console, keys, _ = screen("r", "")
    assert not console.keeps(Step(CONDITION, 100.0, WINDOW))
    assert keys.lines == []


def test_other_keys_keep_nothing(approved: SnapshotAssertion) -> None:
    console, keys, written = screen("", "keep", "K")
    assert console.keeps(Step(CONDITION, 100.0, WINDOW))
    assert written.getvalue() == approved
    assert keys.lines == []


def test_a_key_that_was_typed_before_the_question_keeps_no_take(approved: SnapshotAssertion) -> None:
    keys, written, early = Keys("r", ""), io.StringIO(), ["k\n"]
    console = TerminalTakes(write=written, ask=keys, early=lambda: early.pop() if early else "")
    assert not console.keeps(Step(CONDITION, 100.0, WINDOW))
    assert written.getvalue() == approved
    assert keys.lines == []


def test_silence_cannot_be_kept(approved: SnapshotAssertion) -> None:
    console, keys, written = screen("")
    assert not console.keeps(Step(CONDITION, 100.0, None))
    assert written.getvalue() == approved
    assert keys.lines == []


def test_what_lies_on_the_panel_is_asked_for(approved: SnapshotAssertion) -> None:
    console, keys, written = screen("", "")
    console.place(CONDITION, done=4, total=60)
    console.place(Condition(None, 50.0, 1), done=0, total=60)
    console.arm(CONDITION, attempt=2)
    assert [*keys.prompts, written.getvalue()] == approved


def test_a_recording_asks_for_a_resting_foot_in_the_words_of_a_session() -> None:
    console, keys, written = screen("", "")
    TerminalConsole(write=written, ask=keys, heading="Participant 01.").ask(Rest(""))
    console.rest("")
    assert all(Rest("").text in prompt for prompt in keys.prompts)
