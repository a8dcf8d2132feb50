"""Pictures of a whole practiced visit: run `python -m tests.benchmarks.pictures FOLDER [ID TASK]`.

With the id of a shipped protocol it is the first trials of that task.

A session runs in a process of its own, with the participant's screen in a window on an X server of its own where there
are Xvfb and PsychoPy. Two consoles attend it, one of 80 x 24 characters and one as large as a window of 1280 x 800. The
small one is keyed as an experimenter would; at each new step both, and the window, are drawn into FOLDER. Questions
that practice does not ask are drawn of views that are made up. With Chromium the drawings of consoles become PNG, and
what `--serve` shows in a browser of 1280 x 800 is drawn beside them.

Not a test: it asserts nothing; somebody looks at the pictures.
"""

from __future__ import annotations

import asyncio
import base64
import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import aiohttp
from textual import events
from textual.pilot import Pilot

from palpate.experiment.desk import link
from palpate.experiment.desk.console import transport
from palpate.experiment.desk.console.app import Console, Left
from palpate.experiment.desk.link import Link
from palpate.experiment.desk.link.wire import Asked, Ended, Hello, Standing, Told, View
from palpate.experiment.desk.messages import Choice, Gauges, Lamp
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.rehearsal import study
from tests.experiment.desk.console.scripted import ScriptedEnd
from tests.experiment.protocol.small import SMALL

if TYPE_CHECKING:
    from PIL import Image

SMALL_SIZE, LARGE_SIZE = (80, 24), (132, 40)
"""Columns and rows; a browser draws about so many in 1280 x 800."""
WINDOW_PX = (1280, 800)
APART_S, PATIENCE_S = 1.0, 90.0
SETTLES_S = 0.4

PAUSED_AT, MOST = 2, 4
"""The visit pauses once, when so many answers are on disk; of a shipped protocol so many are drawn."""

STANDING = Standing(
    task="two", purpose="STUDY", trials=40, answered=3, remaining=37, recent=(Told(trial=3, words="felt"),)
)
GAUGES = Gauges(left_s=3300, trace_unit="mm", lamps=(Lamp(name="tracker", good=True, words="1000 Hz"),))
YES_NO = (Choice(key="y", words="yes, continue"), Choice(key="n", words="no, leave"))
BASE = View(study="small", participant="07", step="two", steps=("one", "two", "debriefing"), standing=STANDING)


def made_up() -> dict[str, View]:
    """Return views of what practice never comes to."""
    consent = "Participant 07 has no recorded consent. Did they read the consent text and sign it today?"
    identity = "Is the person in front of you participant 07? Consent was given on 2026-05-04. Complete so far: one."
    rest = "To zero the tracker, have the participant rest the foot still on the bare panel."
    wait = "The break after task one lasts at least 10 min."
    gone = GAUGES.model_copy(update={"lamps": (Lamp(name="tracker", good=False, words="no frame for 3 s"),)})

    def asks(kind: str, text: str, *choices: Choice) -> View:
        asked = Asked.model_validate({"number": 1, "kind": kind, "text": text, "choices": choices})
        return BASE.model_copy(update={"question": asked})

    return {
        "consent": asks("agree", consent, *YES_NO),
        "identity": asks("agree", identity, *YES_NO),
        "rest": asks("rest", rest, Choice(key="enter", words="the foot is resting on the bare panel")),
        "break": asks("break", wait).model_copy(
            update={"state": "paused", "pause_until_ns": time.time_ns() + 312 * 10**9}
        ),
        "waiting": BASE.model_copy(update={"state": "waiting", "gauges": gone, "trial": 4}),
        "error": BASE.model_copy(
            update={
                "state": "ended",
                "ended": Ended(words="tracker at /dev/ttyUSB0: no frame for 300 s; see to its cable", exit_code=2),
            }
        ),
    }


@contextmanager
def display() -> Iterator[str | None]:
    """Run an X server without a monitor, and yield its name; None where there is none."""
    if shutil.which("Xvfb") is None:
        yield None
        return
    reads, writes = os.pipe()
    size = f"{WINDOW_PX[0]}x{WINDOW_PX[1]}x24"
    command = ["Xvfb", "-displayfd", str(writes), "-screen", "0", size, "-nolisten", "tcp"]
    server = subprocess.Popen(command, pass_fds=(writes,), stderr=subprocess.DEVNULL)
    os.close(writes)
    try:
        with os.fdopen(reads) as told:
            yield f":{told.readline().strip()}"
    finally:
        server.terminate()
        server.wait()


def window(name: str) -> Image.Image:
    """Return what a monitor at a display would show."""
    from PIL import Image
    from Xlib import X, display

    with closing(display.Display(name)) as there:
        got = there.screen().root.get_image(0, 0, *WINDOW_PX, X.ZPixmap, 0xFFFFFFFF)
    return Image.frombytes("RGB", WINDOW_PX, got.data, "raw", "BGRX")


def written_rig(folder: Path, protocol: Path, *, screen: bool) -> Path:
    """Write the rig of a protocol's practice, of footsteps with a sound card where there is JACK; and the participant's
    screen, if there is a display.
    """
    shutil.copy(shipped("rigs/rehearsal-response.csv"), folder)
    loaded = files.load(protocol)
    sounds = loaded.find(Footstep) is not None and shutil.which("jackd") is not None
    text = (shipped("rigs/headless.toml") if sounds else study.simulated_rig(loaded)).read_text("utf-8")
    rig = folder / "rig.toml"
    rig.write_text(text + ("\n[screen]\nfullscreen = false\n" if screen else ""), "utf-8")
    return rig


@asynccontextmanager
async def attending(path: Path, size: tuple[int, int]) -> AsyncIterator[tuple[Console, Pilot[Left]]]:
    """Attend a session with a console of this size."""
    with closing(link.Line(path, Hello(role="console", by="lab"))) as line:
        app = Console(line)
        async with app.run_test(size=size) as pilot:
            yield app, pilot


Draws = Callable[[Path], Awaitable[None]]
"""Writes a picture of a browser's page."""


@asynccontextmanager
async def browsing(address: str) -> AsyncIterator[Draws | None]:
    """Open a page in Chromium, 1280 x 800, and yield what draws it; None where there is no Chromium."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        yield None
        return
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0", "--hide-scrollbars"]
        options += [f"--user-data-dir={profile}", f"--window-size={WINDOW_PX[0]},{WINDOW_PX[1]}"]
        process = await asyncio.create_subprocess_exec(browser, *options, address, stderr=subprocess.DEVNULL)
        try:
            while not (told := Path(profile) / "DevToolsActivePort").exists():
                await asyncio.sleep(0.1)
            port = told.read_text("utf-8").split()[0]
            async with aiohttp.ClientSession() as client:
                async with client.get(f"http://127.0.0.1:{port}/json/list") as listed:
                    (page,) = [one for one in await listed.json() if one["type"] == "page"]
                async with client.ws_connect(page["webSocketDebuggerUrl"], max_msg_size=0) as tools:
                    size = {"width": WINDOW_PX[0], "height": WINDOW_PX[1], "deviceScaleFactor": 1, "mobile": False}
                    await tools.send_json({"id": 1, "method": "Emulation.setDeviceMetricsOverride", "params": size})
                    await tools.receive_json()

                    async def draw(file: Path) -> None:
                        await tools.send_json({"id": 2, "method": "Page.captureScreenshot"})
                        file.write_bytes(base64.b64decode((await tools.receive_json())["result"]["data"]))

                    yield draw
        finally:
            process.kill()
            await process.wait()


class Visit:
    """Whoever keys the small console, and draws both, the participant's window, and a browser's page."""

    def __init__(
        self, small: Console, large: Console, folder: Path, screen: str | None, page: Draws | None = None
    ) -> None:
        self.small, self.large = small, large
        self._page = page
        self._folder = folder
        self._screen = screen
        self._drawn = 0

    async def press(self, *keys: str) -> None:
        for key in keys:
            await asyncio.sleep(APART_S)
            character = key if len(key) == 1 else {"enter": "\r", "escape": "\x1b"}.get(key)
            self.small.post_message(events.Key(key, character))

    async def draw(self, name: str) -> None:
        await asyncio.sleep(SETTLES_S)
        self._drawn += 1
        stem = f"{self._drawn:02}-{name}"
        for app, size in ((self.small, "small"), (self.large, "large")):
            (self._folder / f"{stem}-{size}.svg").write_text(app.export_screenshot(title=stem), "utf-8")
        if self._screen is not None:
            window(self._screen).save(self._folder / f"{stem}-window.png")
        if self._page is not None:
            await self._page(self._folder / f"{stem}-served.png")
        sys.stdout.write(f"{stem}\n")
        sys.stdout.flush()

    async def go(self, most: int | None) -> None:
        """Go through the visit to its end, or to so many answers."""
        asked, paused, seen = -1, False, set[str]()
        ends_s = time.monotonic() + PATIENCE_S
        while (view := self.small.view_now).ended is None and time.monotonic() < ends_s:
            if most is not None and view.standing.answered >= most:
                break
            name = view.question.kind if view.question is not None else view.state
            if (new := f"{view.standing.task}-{name}") not in seen:
                seen.add(new)
                await self.draw(new)
            if view.question is not None and view.question.number != asked:
                asked, ends_s = view.question.number, time.monotonic() + PATIENCE_S
                if not paused and view.standing.answered == PAUSED_AT and name != "confirm":
                    paused = True
                    await self.forms()
                    await self.press("f7")
                    continue
                await self.answer(view)
            await asyncio.sleep(0.05)
        await self.draw("ended")

    async def answer(self, view: View) -> None:
        asked = view.question
        if asked is None:
            return
        if asked.kind == "answer":
            words = view.heard.rpartition(": ")[2].rstrip(".")
            keys = [choice.key for choice in asked.choices if choice.answer and words in choice.words]
            await self.press("z")
            await asyncio.sleep(SETTLES_S)
            await self.press(keys[0] if keys else asked.choices[0].key)
        elif asked.kind == "write":
            await self.press("enter", *"Felt real.")
            await self.draw("write-form")
            await self.press("enter")
        else:
            await self.press("enter")

    async def forms(self) -> None:
        """Open every form once, and press a key too early."""
        for key, name in (("f2", "note"), ("f3", "correct"), ("f4", "repeat"), ("f6", "break"), ("f8", "stop")):
            await self.press(key)
            await self.draw(f"form-{name}")
            await self.press("escape")


async def drawn(path: Path, folder: Path, screen: str | None, address: str, most: int | None) -> None:
    """Draw a visit whose session listens at `path`, and whose console is served at `address`, or its first answers."""
    async with (
        browsing(address) as page,
        attending(path, SMALL_SIZE) as (small, _),
        attending(path, LARGE_SIZE) as (large, _),
    ):
        await Visit(small, large, folder, screen, page).go(most)


async def drawn_of_views(folder: Path) -> None:
    """Draw what practice never comes to."""
    with tempfile.TemporaryDirectory() as name:
        path, end = Path(name) / "s", ScriptedEnd(BASE)
        with closing(Link(path, end)) as there:
            async with attending(path, SMALL_SIZE) as (small, one), attending(path, LARGE_SIZE) as (large, _):
                pictures = Visit(small, large, folder, None)
                for what, view in made_up().items():
                    end.view = view
                    there.wake()
                    while view not in (small.view_now,) or view != large.view_now:
                        await one.pause(0.05)
                    await pictures.draw(f"made-up-{what}")


def as_png(folder: Path) -> None:
    """Have Chromium, where there is one, draw every SVG as PNG."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    for file in sorted(folder.glob("*.svg")) if browser else ():
        found = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', file.read_text("utf-8"))
        width, height = (round(float(side)) for side in found.groups()) if found else WINDOW_PX
        with tempfile.TemporaryDirectory() as profile:
            options = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={profile}", "--hide-scrollbars"]
            shot = [f"--screenshot={file.with_suffix('.png')}", f"--window-size={width},{height}", file.as_uri()]
            subprocess.run([str(browser), *options, *shot], capture_output=True, check=False, timeout=120)


@contextmanager
def running(command: list[str], environment: dict[str, str], log: Path) -> Iterator[None]:
    """Run palpate in a process of its own, and end it."""
    with log.open("wb") as said:
        process = subprocess.Popen(
            [sys.executable, "-m", "palpate.experiment", *command], env=environment, stdout=said, stderr=said
        )
        try:
            yield
        finally:
            process.kill()
            process.wait()


def until(holds: Callable[[], object]) -> None:
    """Wait until something holds."""
    ends_s = time.monotonic() + PATIENCE_S
    while not holds() and time.monotonic() < ends_s:
        time.sleep(0.05)


def main() -> None:
    """Draw a visit into the folder that is named."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    named = sys.argv[2:]
    if not named:
        asyncio.run(drawn_of_views(folder))
    with tempfile.TemporaryDirectory() as name, display() as screen:
        there = Path(name)
        protocol = there / "small.toml"
        if named:
            shutil.copy(shipped(f"{named[0]}.toml"), protocol)
        else:
            protocol.write_text(re.sub("repetitions = [0-9]", "repetitions = 2", SMALL), "utf-8")
        rig = written_rig(there, protocol, screen=screen is not None)
        os.environ["XDG_RUNTIME_DIR"] = name
        path = transport.place(there / "data", "01")
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        command = ["run", str(protocol), "--practice", "--rig", str(rig), "--dataset", str(there / "data")]
        command += ["--task", named[1]] if named else []
        environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "HOME": name, "COLUMNS": "300"}
        served = folder / "served.log"
        with running(
            [*command, "--session-at", str(path)],
            environment | ({"DISPLAY": screen} if screen else {}),
            folder / "session.log",
        ):
            until(lambda: transport.answers(path))
            # While the participant's screen opens there is nothing to see.
            until(lambda: screen is None or window(screen).getbbox() is not None)
            with running([*command, "--serve", "127.0.0.1", "--port", str(port)], environment, served):
                until(lambda: "http://" in served.read_text("utf-8"))
                found = re.search(r"http://\S+", served.read_text("utf-8"))
                most = MOST if named else None
                asyncio.run(drawn(path, folder, screen, found[0] if found else "about:blank", most))
    as_png(folder)


if __name__ == "__main__":
    main()
