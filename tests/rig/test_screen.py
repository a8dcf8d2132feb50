"""The participant's screen in a real window, on an X server of our own: seen, keyed, closed, killed and begun again."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.experiment.apparatus.display import ScreenRig, ScreenWords
from palpate.experiment.clock import monotonic_ns
from palpate.experiment.desk import pages
from palpate.experiment.desk.console.transport import answers
from palpate.experiment.desk.link import Line, Link
from palpate.experiment.desk.link.wire import Choose, Deed, Hello, Pause, Shown, Stop, View, Write
from palpate.experiment.desk.messages import ENTER, Message, Prompt
from palpate.experiment.desk.pages import lettering
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import entries, journal, transcript
from tests.experiment.desk.attended import untimed
from tests.experiment.protocol.small import SMALL
from tests.working_folder import LOG, WorkingFolder

pytestmark = pytest.mark.clocked

SIZE_PX = (1280, 800)
WORDS = ScreenWords(right="gutes Tempo", thanks="ありがとうございました。", slow="zu langsam", fast="zu schnell")
INSTRUCTION = "Zerknüllen Sie die vier Zylinder auf der Platte, so oft Sie möchten, bis sie Ihnen vertraut sind."
BEGINS_S = 60.0
"""PsychoPy is imported and its window open within this time, s."""

PRESSES = 40
"""So many keys are pressed to see how late they are dated."""

MASKER = Prompt(show="masker", question=7, keys=("+", "-", ENTER))
PROMPTS: dict[str, Prompt] = {
    "wait": Prompt(),
    "instructions": Prompt(show="instructions", text=INSTRUCTION),
    "instructions in Japanese": Prompt(show="instructions", text="四種類の円筒を、何度でも自由に踏んでください。" * 4),
    "masker": MASKER,
    "masker at its limit": MASKER.model_copy(update={"keys": ("-", ENTER)}),
    "masker with a probe": MASKER.model_copy(update={"keys": ("+", "-", "p", ENTER)}),
    "masker, by the experimenter": Prompt(show="masker"),
    "rest": Prompt(show="rest", label="PRACTICE"),
    "ready": Prompt(show="ready"),
    "ready after a slow step": Prompt(show="ready", pace="slow"),
    "answer after a good step": Prompt(show="answer", pace="right"),
    "ready after a fast step": Prompt(show="ready", pace="fast"),
    "answer": Prompt(show="answer"),
    "break": Prompt(show="break"),
    "break that is over": Prompt(show="break", until_ns=0),
    "compare": Prompt(show="compare", answers=("first", "second", "no difference")),
    "compare, with the lamp dark": Prompt(show="compare", answers=("first", "second"), lamp=False),
    "compare, too fast": Prompt(show="compare", answers=("first", "second"), lamp=True),
    "answers to choose": Prompt(
        show="answer", mode="screen", answers=("copy paper", "aluminum foil"), keys=("c", "a"), question=9, pace="right"
    ),
    "answers to press": Prompt(show="answer", mode="keys", answers=("copy paper", "aluminum foil")),
    "finished": Prompt(show="finished"),
    "finished, and silent": Prompt(show="finished", unmasked=True),
    "thanks": Prompt(show="thanks"),
}


@dataclass
class Display:
    """An X server without a monitor, and the environment of its clients."""

    name: str
    environment: dict[str, str]

    def picture(self) -> NDArray[np.uint8]:
        """Return what a monitor would show, shape (height, width, 3)."""
        from Xlib import X, display

        with closing(display.Display(self.name)) as there:
            got = there.screen().root.get_image(0, 0, *SIZE_PX, X.ZPixmap, 0xFFFFFFFF)
        blue_first = np.frombuffer(got.data, np.uint8).reshape(SIZE_PX[1], SIZE_PX[0], 4)
        return blue_first[:, :, 2::-1]

    def press(self, *keys: str) -> None:
        self.do("key", *keys)

    def do(self, *what: str) -> None:
        subprocess.run(["xdotool", *what], env=self.environment, check=True, timeout=10)

    def close_window(self) -> None:
        """Ask the topmost window to close, as its title bar does."""
        from Xlib import display
        from Xlib.protocol.event import ClientMessage

        with closing(display.Display(self.name)) as there:
            named = [one for one in there.screen().root.query_tree().children if one.get_wm_name() == "palpate"]
            asks, delete = there.intern_atom("WM_PROTOCOLS"), there.intern_atom("WM_DELETE_WINDOW")
            named[-1].send_event(ClientMessage(window=named[-1], client_type=asks, data=(32, [delete, 0, 0, 0, 0])))
            # A server that is busy forgets what a client sent that has left meanwhile.
            there.sync()


@pytest.fixture(scope="module")
def display(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Display]:
    if shutil.which("Xvfb") is None or shutil.which("xdotool") is None:
        pytest.skip("needs an X server without a monitor (packages xvfb, xdotool)")
    if importlib.util.find_spec("psychopy") is None:
        pytest.skip("needs PsychoPy (palpate[lab])")
    home = tmp_path_factory.mktemp("home")
    reads, writes = os.pipe()
    command = ["Xvfb", "-displayfd", str(writes), "-screen", "0", f"{SIZE_PX[0]}x{SIZE_PX[1]}x24", "-nolisten", "tcp"]
    with (home / "xvfb.log").open("wb") as log:
        server = subprocess.Popen(command, pass_fds=(writes,), stdout=log, stderr=log)
    os.close(writes)
    try:
        with os.fdopen(reads) as told:
            name = f":{told.readline().strip()}"
        repository = str(Path(__file__).parents[2])
        runtime = home / "runtime"
        runtime.mkdir(mode=0o700)
        settings = {"DISPLAY": name, "HOME": str(home), "XDG_RUNTIME_DIR": str(runtime), "PYTHONPATH": repository}
        yield Display(name, {**os.environ, **settings})
    finally:
        server.terminate()
        server.wait(10)


class End:
    """A session's end of the link that says what the test wants, and keeps what it is sent."""

    def __init__(self) -> None:
        self.prompt = Prompt()
        self.deeds: list[Deed] = []
        self.came_ns: list[int] = []
        self.screens = 0
        self.link: Link | None = None

    def message(self, role: str) -> Message:
        return self.prompt if role == "screen" else View()

    def take(self, hello: Hello, deed: Deed) -> tuple[bool, str]:
        self.deeds.append(deed)
        self.came_ns.append(monotonic_ns())
        return True, ""

    def came(self, consoles: int, screens: int) -> None:
        self.screens = screens

    def lost(self, why: str) -> None:
        raise AssertionError(why)

    def say(self, prompt: Prompt) -> Shown:
        """Have a prompt shown, and return what the screen says of it."""
        before = len(self.deeds)
        self.prompt = prompt.model_copy(update={"number": self.prompt.number + 1})
        assert self.link is not None
        self.link.wake()
        return self.shown(before)

    def shown(self, before: int = 0) -> Shown:
        wait_until(lambda: any(isinstance(deed, Shown) for deed in self.deeds[before:]), "it was not shown")
        (shown,) = [deed for deed in self.deeds[before:] if isinstance(deed, Shown)]
        assert shown.number == self.prompt.number
        return shown


def wait_until(holds: Callable[[], bool], otherwise: str, timeout_s: float = BEGINS_S) -> None:
    end_s = time.monotonic() + timeout_s
    while not holds():
        assert time.monotonic() < end_s, otherwise
        time.sleep(0.01)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The rehearsal's rig with a screen."""
    folder = tmp_path_factory.mktemp("rig")
    shutil.copy(shipped("rigs/rehearsal-response.csv"), folder)
    words = "".join(f'{name} = "{getattr(WORDS, name)}"\n' for name in ("slow", "right", "fast", "thanks"))
    table = f"\n[screen]\nfullscreen = false\n\n[screen.words]\n{words}"
    file = folder / "rig.toml"
    file.write_text(shipped("rigs/rehearsal.toml").read_text("utf-8") + table, "utf-8")
    return file


@contextmanager
def screen(display: Display, rig: Path, at: Path) -> Iterator[subprocess.Popen[str]]:
    command = [
        sys.executable,
        "-m",
        "palpate.experiment",
        "screen",
        "okamoto2012",
        "--rig",
        str(rig),
        "--session-at",
        str(at),
    ]
    process = subprocess.Popen(command, env=display.environment, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


SCREENS = """\
import json, os, sys
import pyglet
# A window that nobody sees is made as pyglet is imported; here, not before there is a process of its own.
pyglet.options["shadow_window"] = False
from psychopy import logging, visual
from psychopy.hardware import keyboard
from palpate.experiment.__main__ import main
from palpate.experiment.cli import app
from palpate.experiment.desk import screen
visual.Window, visual.ImageStim, visual.Circle
for line in sys.stdin:
    if (process := os.fork()) == 0:
        pyglet.options["shadow_window"] = True
        pyglet.gl._create_shadow_window()
        sys.argv = json.loads(line)
        main()
    print(process, flush=True)
"""
"""Screens that begin in forks of one process, which has spent the seconds that PsychoPy's imports take."""


@pytest.fixture(scope="module")
def screens(display: Display) -> Iterator[subprocess.Popen[str]]:
    """A process that opens a screen for each line with its arguments, and says its number."""
    command, ends = [sys.executable, "-c", SCREENS], subprocess.PIPE
    with subprocess.Popen(command, env=display.environment, stdin=ends, stdout=ends, text=True) as process:
        yield process
        process.kill()


@contextmanager
def forked_screen(screens: subprocess.Popen[str], rig: Path, at: Path) -> Iterator[int]:
    """A screen's process, which ends by SIGKILL at the latest."""
    assert screens.stdin is not None
    assert screens.stdout is not None
    arguments = ["palpate", "screen", "okamoto2012", "--rig", str(rig), "--session-at", str(at)]
    screens.stdin.write(json.dumps(arguments) + "\n")
    screens.stdin.flush()
    process = int(screens.stdout.readline())
    try:
        yield process
    finally:
        # Nobody waits for it, so no other process has its number.
        os.kill(process, 9)


@pytest.fixture(scope="module")
def end(tmp_path_factory: pytest.TempPathFactory) -> Iterator[End]:
    made = End()
    path = tmp_path_factory.mktemp("link") / "s.sock"
    made.link = Link(path, made)
    yield made
    made.link.close()


@pytest.fixture(scope="module")
def window(display: Display, rig: Path, end: End) -> Iterator[subprocess.Popen[str]]:
    assert end.link is not None
    with screen(display, rig, end.link._path) as process:
        wait_until(lambda: end.screens == 1 or process.poll() is not None, "no screen came")
        assert process.poll() is None, process.communicate()[1]
        end.shown()
        yield process


def expected(prompt: Prompt | None) -> NDArray[np.uint8]:
    page = pages.page(prompt, ScreenRig(words=WORDS), 1)
    font, missing = lettering.font_for(page.letters, None)
    if missing:
        pytest.skip("needs a font with Japanese letters (package fonts-ipafont-gothic)")
    return np.asarray(pages.drawn(page, SIZE_PX, font)[0])


def off(picture: NDArray[np.uint8], page: NDArray[np.uint8]) -> int:
    """Return by how much a picture differs from a page, of 255; a texture rounds by one or two."""
    return int(np.abs(picture.astype(int) - page).max())


@pytest.mark.parametrize("prompt", PROMPTS.values(), ids=PROMPTS)
def test_every_prompt_is_seen(display: Display, end: End, window: subprocess.Popen[str], prompt: Prompt) -> None:
    end.say(prompt)
    picture = display.picture()
    folder = os.environ.get("PALPATE_PICTURES")
    if folder:
        from PIL import Image

        Image.fromarray(picture).save(Path(folder) / f"{list(PROMPTS.values()).index(prompt):02}-{prompt.show}.png")
    assert off(picture, expected(prompt)) <= 2
    assert window.poll() is None


def test_it_tells_when_a_prompt_was_seen(end: End, window: subprocess.Popen[str]) -> None:
    end.say(Prompt(show="ready"))
    asked_ns = monotonic_ns()
    shown = end.say(Prompt(show="answer"))
    assert asked_ns < shown.t_ns < end.came_ns[-1]


def test_the_participants_keys_choose_or_stop_and_others_do_nothing(
    display: Display, end: End, window: subprocess.Popen[str]
) -> None:
    end.say(MASKER)
    before = len(end.deeds)
    for key in ("q", "Up", "Escape", "Down", "Return", "plus", "F4"):
        display.press(key)
        time.sleep(0.1)
    wait_until(lambda: len(end.deeds) >= before + 4, "the keys did not come")
    louder, softer, done = (Choose(question=7, key=key, t_ns=0) for key in ("+", "-", ENTER))
    assert list(map(untimed, end.deeds[before:])) == [louder, Pause(), softer, done]
    assert window.poll() is None


def test_a_key_that_is_held_is_one_press(display: Display, end: End, window: subprocess.Popen[str]) -> None:
    """X repeats a key from 0.66 s on, 25 times a second."""
    end.say(MASKER.model_copy(update={"keys": ("h", "-", ENTER)}))
    end.say(MASKER)
    before = len(end.deeds)
    for key in ("Up", "Down"):
        display.do("keydown", key)
        time.sleep(1.5)
        display.do("keyup", key)
    for _ in range(3):
        display.press("Up")
        time.sleep(0.1)
    wait_until(lambda: len(end.deeds) >= before + 5, "the keys did not come")
    assert list(map(untimed, end.deeds[before:])) == [Choose(question=7, key=key, t_ns=0) for key in "+-+++"]


def test_where_nothing_is_asked_no_key_does_anything(display: Display, end: End, window: subprocess.Popen[str]) -> None:
    end.say(Prompt(show="answer"))
    before = len(end.deeds)
    display.press("Up")
    display.press("Return")
    end.say(MASKER)
    time.sleep(0.3)
    assert [deed for deed in end.deeds[before:] if isinstance(deed, Choose)] == []


def test_the_hand_is_seen_on_the_block_and_moves(display: Display, end: End, window: subprocess.Popen[str]) -> None:
    said = "Tap the block as often as you like, gently enough that the lamp stays dark."
    practice = Prompt(show="instructions", text=said, lamp=False, hand_mm=12.0)
    end.say(practice)
    told = len(end.deeds)
    rows: list[int] = []
    for hand_mm in (12.0, 6.0, 0.0):
        end.prompt = end.prompt.model_copy(update={"hand_mm": hand_mm})
        middle, _ = pages.hand_px(hand_mm, SIZE_PX)
        rows.append(round(SIZE_PX[1] / 2 - middle))
        wait_until(lambda: tuple(display.picture()[rows[-1], SIZE_PX[0] // 2]) == pages.TEXT, "no hand is there", 5)
        if folder := os.environ.get("PALPATE_PICTURES"):
            from PIL import Image

            Image.fromarray(display.picture()).save(Path(folder) / f"hand-{hand_mm:g}.png")
    assert rows == sorted(rows)
    # A hand that moves is no other page.
    assert len(end.deeds) == told


def test_a_break_counts_down_on_the_screen(display: Display, end: End, window: subprocess.Popen[str]) -> None:
    end.say(Prompt(show="break", until_ns=time.time_ns() + 90_000_000_000))
    first = display.picture()
    wait_until(lambda: off(display.picture(), first) > 2, "the clock stands still", 5)
    changed = np.flatnonzero((display.picture() != first).any(axis=(1, 2)))
    # The sentence above the clock stays.
    assert changed[0] > 300


def test_an_answer_is_chosen_by_a_key_or_by_the_mouse_and_dated_when_it_is_pressed(
    display: Display, end: End, window: subprocess.Popen[str]
) -> None:
    """The key comes through the X server's own test extension, so that it is known when it was pressed."""
    from Xlib import X
    from Xlib import display as servers
    from Xlib.ext import xtest

    asking = Prompt(show="answer", mode="screen", answers=("copy paper", "foil"), keys=("c", "a"), question=9)
    end.say(asking)
    boxes = pages.boxes(2, SIZE_PX)
    x, y = ((boxes[0][0] + boxes[0][2]) / 2, (boxes[0][1] + boxes[0][3]) / 2)
    display.do("windowfocus", display_window(display))

    def choices() -> list[Choose]:
        return [deed for deed in end.deeds if isinstance(deed, Choose) and deed.question == 9]

    display.press("2")
    wait_until(lambda: len(choices()) == 1, "the key chose nothing", 5)
    display.do("mousemove", str(round(x)), str(round(y)), "click", "1")
    wait_until(lambda: len(choices()) == 2, "the click chose nothing", 5)
    display.do("mousemove", "5", "5", "click", "1")
    assert [deed.key for deed in choices()] == ["a", "c"]
    late_ms = []
    with closing(servers.Display(display.name)) as there:
        one = there.keysym_to_keycode(ord("1"))
        for n in range(PRESSES):
            pressed_ns = monotonic_ns()
            xtest.fake_input(there, X.KeyPress, one)
            there.sync()
            wait_until(lambda n=n: len(choices()) == 3 + n, "the key chose nothing", 5)  # type: ignore[misc]
            late_ms.append((choices()[-1].t_ns - pressed_ns) / 1e6)
            xtest.fake_input(there, X.KeyRelease, one)
            there.sync()
            time.sleep(0.05)
    print(f"\nscreen: from key to its time {np.median(late_ms):.1f} ms, 95 % {np.percentile(late_ms, 95):.1f} ms")
    assert all(0 <= late < 1000 for late in late_ms)
    assert all(deed.error_s is not None for deed in choices())


def display_window(display: Display) -> str:
    found = subprocess.run(
        ["xdotool", "search", "--name", "^palpate$"],
        env=display.environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return found.stdout.split()[-1]


def test_it_costs_the_session_no_core(display: Display, end: End, window: subprocess.Popen[str]) -> None:
    import psutil

    end.say(Prompt(show="ready"))
    process = psutil.Process(window.pid)
    before = process.cpu_times()
    time.sleep(3)
    after = process.cpu_times()
    assert (after.user + after.system - before.user - before.system) / 3 < 0.25


def test_a_second_screen_is_refused(display: Display, end: End, rig: Path, window: subprocess.Popen[str]) -> None:
    assert end.link is not None
    with screen(display, rig, end.link._path) as second:
        said = second.communicate(timeout=BEGINS_S)[1]
    assert said == "palpate: this session's screen is already open; close that screen first, or use it\n"
    assert second.returncode == 2


def test_it_outlives_its_session_and_a_session_outlives_it(
    display: Display, screens: subprocess.Popen[str], rig: Path, tmp_path: Path
) -> None:
    path = tmp_path / "s.sock"
    first, second = End(), End()
    first.prompt = Prompt(number=5, show="ready")
    with forked_screen(screens, rig, path) as process:
        with closing(Link(path, first)) as first.link:
            first.shown()
        wait_until(lambda: off(display.picture(), expected(None)) <= 2, "it does not ask the participant to wait")
        second.prompt = Prompt(number=1, show="answer")
        second.link = Link(path, second)
        second.shown()
        assert off(display.picture(), expected(second.prompt)) <= 2
        os.kill(process, 9)
        wait_until(lambda: second.screens == 0, "the session did not notice")
    second.prompt = Prompt(number=2, show="ready", pace="fast")
    with forked_screen(screens, rig, path):
        second.shown(1)
        assert off(display.picture(), expected(second.prompt)) <= 2
        second.say(Prompt(show="thanks"))
        second.link.close()
        time.sleep(0.5)
        assert off(display.picture(), expected(Prompt(show="thanks"))) <= 2


def test_it_opens_without_a_flash_and_ctrl_c_closes_it(display: Display, rig: Path, tmp_path: Path) -> None:
    end = End()
    with closing(Link(tmp_path / "s.sock", end)) as end.link, screen(display, rig, tmp_path / "s.sock") as process:
        wait_until(lambda: display.picture().max() >= 220 or bool(end.deeds), "it was not shown")
        assert display.picture().max() < 220
        process.send_signal(2)
        assert process.communicate(timeout=20)[1] == ""
        assert process.returncode == 0
        wait_until(lambda: end.screens == 0, "the session did not notice")


def test_its_window_may_be_closed(display: Display, rig: Path, tmp_path: Path) -> None:
    end = End()
    with closing(Link(tmp_path / "s.sock", end)) as end.link, screen(display, rig, tmp_path / "s.sock") as process:
        end.shown()
        display.close_window()
        assert process.communicate(timeout=20)[1] == ""
        assert process.returncode == 0
        wait_until(lambda: end.screens == 0, "the session did not notice")


def refused(display: Display, rig: Path, at: Path, **environment: str) -> str:
    other = Display(display.name, display.environment | environment)
    with screen(other, rig, at) as process:
        said = process.communicate(timeout=BEGINS_S)[1]
    assert process.returncode == 2
    assert said.startswith("palpate: ")
    assert said.count("\n") == 1, said
    return said


def test_without_psychopy_it_says_what_to_install(display: Display, rig: Path, tmp_path: Path) -> None:
    (tmp_path / "psychopy.py").write_text("raise ImportError('no psychopy here')\n", "utf-8")
    path = f"{tmp_path}{os.pathsep}{display.environment['PYTHONPATH']}"
    said = refused(display, rig, tmp_path / "s.sock", PYTHONPATH=path)
    assert "needs PsychoPy (no psychopy here); install palpate[lab]" in said


def test_without_a_display_it_says_where_to_run_it(display: Display, rig: Path, tmp_path: Path) -> None:
    said = refused(display, rig, tmp_path / "s.sock", DISPLAY=":9999")
    assert "cannot be opened" in said
    assert "with DISPLAY set" in said


def test_a_display_that_is_not_there_is_never_another(display: Display, rig: Path, tmp_path: Path) -> None:
    """PsychoPy would take the first one, where the experimenter may sit."""
    file = tmp_path / "rig.toml"
    shutil.copy(rig.with_name("rehearsal-response.csv"), tmp_path)
    file.write_text(rig.read_text("utf-8").replace("[screen]\n", "[screen]\ndisplay = 3\n"), "utf-8")
    said = refused(display, file, tmp_path / "s.sock")
    assert "screen.display: got 3; allowed: 0 to 0 on this machine" in said


def test_a_session_opens_its_screen_and_goes_on_without_it(
    display: Display, rig: Path, tmp_path: Path, working_folder: WorkingFolder
) -> None:
    """A practice whose screen is killed as it asks for the first answer; two trials are answered all the same."""
    protocol = tmp_path / "small.toml"
    protocol.write_text(SMALL, "utf-8")
    at, data = tmp_path / "s.sock", tmp_path / "data"
    command = [sys.executable, "-P", "-m", "palpate.experiment", "run", str(protocol), "--practice", "--rig", str(rig)]
    command += ["--dataset", str(data), "--session-at", str(at)]
    with (tmp_path / "log").open("wb") as log:
        environment = {**display.environment, LOG: str(working_folder.log)}
        session = subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=log, stderr=log)
    try:
        wait_until(lambda: answers(at) or session.poll() is not None, "no session")
        assert session.poll() is None, (tmp_path / "log").read_text("utf-8")
        console = Line(at, Hello(role="console", by="console"))
        answered, killed, steps = set[int](), False, 0
        for message in console.messages():
            assert working_folder.imported == []
            if not isinstance(message, View):
                continue
            connected = [one.good for one in (message.gauges.lamps if message.gauges else ()) if one.name == "screen"]
            asked = message.question
            if asked is None or asked.number in answered:
                continue
            if asked.kind == "familiarise" and connected != [True]:
                continue
            if asked.kind == "answer" and not killed:
                os.kill(_screen_of(session.pid), 9)
                killed = True
                continue
            if asked.kind == "answer" and steps == 0 and connected != [False]:
                continue
            answered.add(asked.number)
            if asked.kind == "continue":
                console.send(Stop())
                break
            keys = [choice.key for choice in asked.choices]
            steps += asked.kind == "answer"
            console.send(Stop() if steps == 3 else Choose(question=asked.number, key=keys[0]))
            if steps == 3:
                break
        assert session.wait(30) == 0, (tmp_path / "log").read_text("utf-8")
        console.close()
    finally:
        session.kill()
        session.wait()
    (written,) = data.rglob("*_journal.jsonl")
    contents = journal.read(written)
    shows = [(line.t_ns, entry) for line in contents.lines if isinstance(entry := line.entry, entries.Shown)]
    assert "ready" in [entry.show for _, entry in shows]
    assert all(0 < t_ns - entry.since_ns < 60e9 for t_ns, entry in shows)
    assert sum(isinstance(entry, entries.Answer) for entry in contents.entries) == 2
    assert "the participant's screen shows 'ready'" in transcript.text(contents)


SHOWN = {
    "familiarise": "instructions",
    "place": "wait",
    "armed": "ready",
    "answer": "answer",
    "confirm": "answer",
    "write": "finished",
    "debrief": "finished",
}
"""What the participant sees at each step of a practiced visit, before the first answer of a task."""


def test_a_screen_that_is_killed_at_every_step_comes_back_there(
    display: Display, screens: subprocess.Popen[str], rig: Path, tmp_path: Path
) -> None:
    """The session stands at its question meanwhile, and everything that is answered is on record in the end."""
    protocol = tmp_path / "small.toml"
    protocol.write_text(re.sub("repetitions = [0-9]", "repetitions = 1", SMALL), "utf-8")
    at, data, left = tmp_path / "s.sock", tmp_path / "data", dict(SHOWN)
    command = [sys.executable, "-m", "palpate.experiment", "run", str(protocol), "--practice", "--rig", str(rig)]
    command += ["--dataset", str(data), "--session-at", str(at)]
    with (tmp_path / "log").open("wb") as log, ExitStack() as opened:
        session = subprocess.Popen(command, env=display.environment, stdout=log, stderr=log)
        opened.callback(session.wait)
        opened.callback(session.kill)
        wait_until(lambda: answers(at) or session.poll() is not None, "no session")
        console = Line(at, Hello(role="console", by="console"))
        opened.callback(console.close)
        now_open = 0
        step, asked, answered, gone = "", -1, -1, False
        for message in console.messages():
            if not isinstance(message, View) or message.gauges is None:
                continue
            connected = [one.good for one in message.gauges.lamps if one.name == "screen"] == [True]
            question = message.question
            now = question.kind if question is not None else message.state
            if now in left and not step and connected:
                step, asked, gone = now, question.number if question is not None else -1, False
                os.kill(now_open or _screen_of(session.pid), 9)
            elif step and not connected and not gone:
                gone = True
                now_open = opened.enter_context(forked_screen(screens, rig, at))
            elif step and connected and gone:
                assert asked < 0 or (question is not None and question.number == asked), "session went on"
                # The foot may have stepped meanwhile: who is armed is not held up.
                _wait_for(data, left[step] if asked >= 0 else "answer")
                left.pop(step)
                step = ""
            if step or question is None or question.number == answered or (now in left and now != "armed"):
                continue
            answered = question.number
            if question.kind == "write":
                console.send(Write(question=question.number, text="nothing"))
            else:
                console.send(Choose(question=question.number, key=question.choices[0].key))
        assert session.wait(BEGINS_S) == 0, (tmp_path / "log").read_text("utf-8")
    assert not left
    for file in data.rglob("*_journal.jsonl"):
        found = journal.read(file).entries
        assert sum(isinstance(entry, entries.Answer) for entry in found) == 2


def _wait_for(data: Path, show: str) -> None:
    """Wait until this is what the participant's screen showed last, by the journals."""

    def last() -> str:
        lines = [line for file in data.rglob("*_journal.jsonl") for line in journal.read_if_begun(file).lines]
        shown = [(line.t_ns, line.entry.show) for line in lines if isinstance(line.entry, entries.Shown)]
        return max(shown)[1] if shown else ""

    wait_until(lambda: last() == show, f"'{show}' was not shown")


def _screen_of(session: int) -> int:
    import psutil

    (found,) = [one.pid for one in psutil.Process(session).children() if "screen" in one.cmdline()]
    return int(found)
