"""The experimenter's screen in a pipe."""

from __future__ import annotations

import io
import os
from collections import deque

import pytest

from experiment.desk.terminal import TerminalConsole
from experiment.errors import ScreenGone

KEYS = {"c": "copy paper", "n": "no answer"}


def console(*typed: str) -> tuple[TerminalConsole, io.StringIO, list[str]]:
    lines, screen, prompts = deque(typed), io.StringIO(), list[str]()

    def ask(prompt: str) -> str:
        prompts.append(prompt)
        return lines.popleft()

    return TerminalConsole(write=screen, ask=ask, heading="Participant 01."), screen, prompts


def test_an_answer_is_keyed_shown_and_confirmed() -> None:
    one, _, prompts = console("C ", "")
    assert one.ask(trial=3, keys=KEYS) == "c"
    assert "[c] copy paper  [n] no answer" in prompts[0]
    assert prompts[1].startswith("copy paper - press Enter to confirm")


def test_a_wrong_key_is_named_and_asked_again() -> None:
    one, screen, _ = console("x", "n", "")
    assert one.ask(trial=3, keys=KEYS) == "n"
    assert screen.getvalue() == "'x' is not a key of this protocol; press one of c n\n"


def test_an_answer_that_is_not_confirmed_is_asked_again() -> None:
    one, _, prompts = console("c", "no", "n", "")
    assert one.ask(trial=3, keys=KEYS) == "n"
    assert len(prompts) == 4


def test_the_real_object_is_laid_out_before_the_participant_may_step() -> None:
    one, screen, prompts = console("")
    one.place(trial=2, material="copy paper")
    one.arm(trial=2, attempt=3, trials=40)
    assert prompts == ["Participant 01.  Trial 2. Lay out copy paper, then press Enter: "]
    assert screen.getvalue() == "Participant 01.  Trial 2 of 40, attempt 3. Armed: the participant may step.\n"


def test_a_foot_that_did_not_rest_is_told_so_and_asked_again() -> None:
    one, screen, prompts = console("", "")
    one.rest(why="")
    one.rest(why="zeroing: got 9 mm; rest the foot")
    assert len(prompts) == 2
    for prompt in prompts:
        assert prompt.startswith("Participant 01.  Zeroing: have the foot rest still on the bare panel. Then press")
        assert prompt.endswith("or press Ctrl-C to pause; the same command continues: ")
    assert screen.getvalue() == "zeroing: got 9 mm; rest the foot\n"


def test_a_step_that_broke_off_is_named() -> None:
    one, screen, _ = console()
    one.rearm(trial=2, attempt=2, reason="the foot turned back above the panel")
    assert screen.getvalue() == (
        "Participant 01.  Trial 2, attempt 2: the foot turned back above the panel; nothing was played. Armed again: "
        "the participant may lift the foot and step.\n"
    )


def test_the_maskers_level_is_shown_changed_and_kept() -> None:
    keys = {"+": "masker louder", "-": "masker softer"}
    one, screen, prompts = console("+", "x", "-", "")
    asked = [one.level(level_db_a=50.4, limit_db_a=80.0, criterion="Nothing is heard.", keys=keys) for _ in range(3)]
    assert asked == ["+", "-", ""]
    assert prompts[0] == "[+] masker louder  [-] masker softer  [Enter] keep the level\nKey: "
    assert screen.getvalue().splitlines() == [
        *["Participant 01.  Masker at 50 dB(A), at most 80. Nothing is heard."] * 2,
        "'x' does not change the level; press one of + -, or Enter",
        "Participant 01.  Masker at 50 dB(A), at most 80. Nothing is heard.",
    ]


def test_a_key_of_the_masker_is_not_confirmed() -> None:
    one, _, prompts = console("+")
    assert one.ask(trial=1, keys=KEYS | {"+": "masker louder"}) == "+"
    assert len(prompts) == 1


def test_the_end_of_the_input_interrupts_as_the_keyboard_does() -> None:
    def ended(_: str) -> str:
        raise EOFError

    one = TerminalConsole(write=io.StringIO(), ask=ended, heading="")
    with pytest.raises(KeyboardInterrupt):
        one.ask(trial=1, keys=KEYS)


def test_what_is_on_disk_is_said() -> None:
    one, screen, _ = console("")
    one.familiarise(instruction="Crinkle them.", min_s=180, max_s=300)
    one.confirmed(trial=1, answer=None)
    assert screen.getvalue().splitlines() == [
        "Participant 01.  Familiarisation, 3.0 to 5.0 min. Crinkle them.",
        "Participant 01.  Trial 1: the answer is on disk: no answer.",
    ]


def test_a_screen_that_is_closed_is_named() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with open(writing, "w", encoding="utf-8", closefd=False) as pipe:
        one = TerminalConsole(write=pipe, ask=lambda _: "", heading="")
        with pytest.raises(ScreenGone, match=r"the screen is gone \(.*Broken pipe\)"):
            one.confirmed(trial=1, answer="foil")
        os.dup2(os.open(os.devnull, os.O_WRONLY), writing)
    os.close(writing)
    one, screen, _ = console("")
    screen.close()
    with pytest.raises(ScreenGone, match="closed file"):
        one.show("")


def test_a_prompt_that_nobody_can_see_is_a_screen_that_is_gone() -> None:
    def ask(_: str) -> str:
        raise OSError(5, "Input/output error")

    with pytest.raises(ScreenGone, match="Input/output error"):
        TerminalConsole(write=io.StringIO(), ask=ask, heading="").place(trial=1, material="foil")
