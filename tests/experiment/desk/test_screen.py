"""The participant's screen without a window: what it draws when, what it sends back, and how it outlives a session."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import pytest
from PIL import Image as Pictures
from PIL.Image import Image
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus.display import ScreenKeys, ScreenRig
from palpate.experiment.clock import monotonic_ns
from palpate.experiment.desk import pages, screen
from palpate.experiment.desk.link import Line, Link
from palpate.experiment.desk.link.wire import Choose, Deed, Hello, Pause, Shown, View
from palpate.experiment.desk.messages import ENTER, Message, Prompt
from palpate.experiment.desk.pages import lettering
from palpate.experiment.desk.screen import Feed, Heard, Screen
from palpate.experiment.errors import DisplayError, LinkError
from tests.approved import Refuses
from tests.experiment.desk.attended import untimed


class Window:
    """A window that holds what is drawn, and is closed after as many rounds as the test has keys for."""

    size_px = (640, 400)

    def __init__(self, *rounds: list[str], as_drawn: str = "up") -> None:
        self.rounds = list(rounds)
        self.as_drawn = as_drawn
        self.pictures: list[Image] = []
        self.hands: list[float | None] = []
        self.seen = 0
        self.seen_ns = 0
        self.fresh = False
        self.clicks: list[list[tuple[float, float]]] = []
        self.mouse: list[bool] = []

    @property
    def closed(self) -> bool:
        return not self.rounds

    def put(self, picture: Image) -> None:
        self.pictures.append(picture)
        self.fresh = True

    def show(self, hand_mm: float | None) -> int:
        self.seen += 1
        self.hands.append(hand_mm)
        self.seen_ns = monotonic_ns()
        return self.seen_ns

    def pressed(self) -> list[str]:
        if self.fresh:
            # What was pressed while the page was drawn.
            self.fresh = False
            return [self.as_drawn]
        return self.rounds.pop(0)

    def clicked(self) -> list[tuple[float, float]]:
        return self.clicks.pop(0) if self.clicks and not self.fresh else []

    def offer(self, *, mouse: bool) -> None:
        self.mouse.append(mouse)

    def close(self) -> None:
        pass


class Sent:
    """A way to the session that keeps what is sent."""

    def __init__(self, *, gone: bool = False) -> None:
        self.deeds: list[Deed] = []
        self.gone = gone

    def send(self, deed: Deed) -> int:
        if self.gone:
            raise LinkError("the session is gone")
        self.deeds.append(deed)
        return 0


class Told:
    """A feed that hears one thing after the other."""

    def __init__(self, *heard: Heard) -> None:
        self.rest = list(heard)

    def heard(self) -> Heard:
        return self.rest.pop(0) if len(self.rest) > 1 else self.rest[0]


class Inline(ThreadPoolExecutor):
    """Draws before the next round."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        wait([drawing := super().submit(fn, *args, **kwargs)])
        return drawing


@pytest.fixture(autouse=True)
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(screen, "POLL_S", 0.0)
    monkeypatch.setattr(screen, "ThreadPoolExecutor", Inline)


MASKER = Prompt(number=4, show="masker", question=9, keys=("+", "-", ENTER))


def run(feed: Told, window: Window, settings: ScreenRig | None = None, *, stays: bool = True) -> list[str]:
    said: list[str] = []
    Screen(feed, window, settings or ScreenRig(), Path(), said.append, stays=stays).run()  # type: ignore[arg-type]
    return said


def heard(sent: Sent | None, prompt: Prompt | None) -> Heard:
    return Heard(sent, prompt)  # type: ignore[arg-type]


def test_a_screen_of_another_protocol_is_refused_where_that_has_not_the_sessions_pictures() -> None:
    window, prompt = Window([], [], [], []), Prompt(number=3, show="ready", text="Step.", pictures=("foot.png",))
    with pytest.raises(DisplayError):
        run(Told(heard(Sent(), prompt)), window)
    assert not window.pictures


def test_a_page_is_drawn_once_and_told_once() -> None:
    sent, window = Sent(), Window([], [], [], [])
    run(Told(heard(sent, Prompt(number=3, show="ready"))), window)
    assert (len(window.pictures), window.seen) == (1, 1)
    assert sent.deeds == [Shown(number=3, t_ns=window.seen_ns)]


def test_a_long_instruction_is_turned_forth_and_back_and_told_once(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[int] = []

    def part(page: pages.Page, *_: object) -> tuple[Image, int]:
        drawn.append(page.part)
        return Pictures.new("RGB", Window.size_px), 3

    monkeypatch.setattr(pages, "drawn", part)
    sent = Sent()
    long, ready = Prompt(number=3, text="Tap. " * 400), Prompt(number=4, show="ready", text="Tap. " * 400)
    keys = [[], ["pageup"], ["pagedown"], ["pagedown"], ["pagedown"], ["pageup"], [], []]
    last = [heard(sent, ready)] * 4 + [heard(sent, Prompt(number=5, text="Step."))]
    run(Told(*[heard(sent, long)] * 8, *last), Window(*keys, *[[]] * 6, as_drawn="up"))
    # What was being read stays while the line above it changes; another text begins at its beginning.
    assert drawn == [0, 1, 2, 1, 1, 0]
    assert [deed.number for deed in sent.deeds if isinstance(deed, Shown)] == [3, 4, 5]


def test_a_hand_that_moves_is_shown_without_another_page_and_told_by_nobody() -> None:
    sent, window = Sent(), Window([], [], [], [])
    practice = Prompt(number=3, show="instructions", text="Tap.", hand_mm=5.0)
    moved = [heard(sent, practice.model_copy(update={"hand_mm": mm})) for mm in (4.0, 3.0)]
    run(Told(heard(sent, practice), *moved), window)
    assert (len(window.pictures), window.hands) == (1, [5.0, 4.0, 3.0])
    assert len(sent.deeds) == 1


def test_a_key_answers_the_question_that_was_seen() -> None:
    sent = Sent()
    next_one = MASKER.model_copy(update={"question": 10})
    window = Window([], ["up", "a"], ["down"], ["return"], ["escape"])
    run(Told(heard(sent, MASKER), heard(sent, MASKER), heard(sent, next_one)), window)
    keys = [untimed(deed) for deed in sent.deeds if isinstance(deed, Choose)]
    assert keys == [
        Choose(question=9, key="+", t_ns=0),
        Choose(question=9, key="-", t_ns=0),
        Choose(question=10, key=ENTER, t_ns=0),
    ]
    assert len(window.pictures) == 1


def test_a_key_pressed_before_a_page_was_seen_answers_nothing_on_it() -> None:
    sent = Sent()
    run(Told(heard(sent, Prompt()), heard(sent, MASKER)), Window(["up"], ["up"]))
    assert [deed for deed in sent.deeds if isinstance(deed, Choose)] == []


def test_without_a_session_the_participant_is_asked_to_wait_and_later_sees_where_it_is() -> None:
    sent, again, window = Sent(), Sent(), Window([], [], [], ["up"], [])
    ready = Prompt(number=1, show="ready")
    run(Told(heard(sent, ready), heard(None, None), heard(None, None), heard(again, ready)), window)
    first, gone, last = (picture.tobytes() for picture in window.pictures)
    assert first == last != gone
    assert (len(sent.deeds), len(again.deeds)) == (1, 1)


def test_a_session_that_goes_while_a_key_is_sent_harms_nothing() -> None:
    run(Told(heard(Sent(gone=True), MASKER)), Window([], ["up"], []))


def test_thanks_stand_for_a_while_once_the_session_has_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(screen, "FAREWELL_NS", 0)
    window = Window([], [], [], [])
    run(Told(heard(Sent(), Prompt(number=5, show="thanks")), heard(None, Prompt(number=5, show="thanks"))), window)
    assert window.rounds
    assert len(window.pictures) == 1


@pytest.mark.parametrize("stays", [True, False])
def test_a_screen_that_a_session_opened_leaves_when_no_session_is_there(
    monkeypatch: pytest.MonkeyPatch, stays: bool
) -> None:
    monkeypatch.setattr(screen, "FAREWELL_NS", 0)
    window = Window(*[[]] * 9)
    run(Told(heard(None, None), heard(Sent(), Prompt(number=5, show="ready")), heard(None, None)), window, stays=stays)
    assert bool(window.rounds) is not stays


def test_letters_that_no_font_has_are_told_once(approved: SnapshotAssertion) -> None:
    prompt = Prompt(show="instructions", text="踏 on")
    words = ScreenRig(font=str(lettering.font_for(frozenset("a"), None)[0]))
    heard_ = [heard(Sent(), prompt), heard(None, None), heard(Sent(), prompt)]
    (said,) = run(Told(*heard_), Window([], [], [], []), words)
    assert said == approved
    assert "fonts-ipafont-gothic" in said


class End:
    """A session's end of the link that says one prompt."""

    def __init__(self, prompt: Prompt) -> None:
        self.prompt = prompt
        self.deeds: list[tuple[str, Deed]] = []

    def message(self, role: str) -> Message:
        return self.prompt if role == "screen" else View()

    def take(self, hello: Hello, deed: Deed) -> tuple[bool, str]:
        self.deeds.append((hello.role, deed))
        return True, ""

    def came(self, consoles: int, screens: int) -> None:
        self.screens = screens

    def lost(self, why: str) -> None:
        raise AssertionError(why)


def until(feed: Feed, prompt: Prompt | None, *, gone: bool = False) -> Heard:
    for _ in range(500):
        if (now := feed.heard()).prompt == prompt and (now.line is None or not gone):
            return now
        feed._closing.wait(0.01)
    raise AssertionError(f"heard {feed.heard().prompt}, never {prompt}")


def test_a_feed_finds_loses_and_finds_a_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(screen, "AGAIN_S", 0.01)
    path = tmp_path / "s.sock"
    feed = Feed(path)
    assert feed.heard() == Heard()
    for number, show in ((1, "ready"), (1, "ready"), (2, "thanks")):
        end = End(Prompt.model_validate({"number": number, "show": show}))
        link = Link(path, end)
        assert until(feed, end.prompt).line is not None
        assert end.screens == 1
        link.close()
        until(feed, end.prompt if show == "thanks" else None, gone=True)
    assert until(feed, end.prompt, gone=True) == Heard(None, end.prompt)
    feed.close()


def test_a_session_of_another_version_ends_the_screen_in_words(tmp_path: Path, refuses: Refuses) -> None:
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "s.sock"))
        server.listen()
        feed = Feed(tmp_path / "s.sock")
        there, _ = server.accept()
        there.sendall(b'{"kind": "poster"}\n')
        with refuses(LinkError):
            until(feed, Prompt(number=99))
        there.close()
        feed.close()


def test_a_silent_session_is_not_taken_for_a_lost_one(tmp_path: Path) -> None:
    """PsychoPy gives every new socket of its process a timeout of 20 s."""
    end = End(Prompt(number=1, show="ready"))
    link = Link(tmp_path / "s.sock", end)
    before = socket.getdefaulttimeout()
    socket.setdefaulttimeout(0.05)
    try:
        line = Line(tmp_path / "s.sock", Hello(role="screen", by="screen"))
    finally:
        socket.setdefaulttimeout(before)
    messages = line.messages()
    assert next(messages) == end.prompt
    end.prompt = Prompt(number=2, show="answer")
    assert next(messages) == end.prompt
    line.close()
    link.close()


def test_a_session_has_one_screen(tmp_path: Path) -> None:
    with (
        screen.alone(tmp_path / "s.sock"),
        pytest.raises(DisplayError, match="already open"),
        screen.alone(tmp_path / "s.sock"),
    ):
        raise AssertionError("two screens at once")
    with screen.alone(tmp_path / "s.sock"):
        pass


@pytest.mark.parametrize("prompt", [MASKER, Prompt(number=5, show="ready"), None], ids=["masker", "ready", "nothing"])
def test_the_participants_key_stops_at_any_moment(prompt: Prompt | None) -> None:
    sent = Sent()
    run(Told(heard(sent, prompt)), Window([], ["escape"], ["e"]))
    assert sum(isinstance(deed, Pause) for deed in sent.deeds) == 1
    run(Told(heard(sent, prompt)), Window([], as_drawn="escape"))
    assert sum(isinstance(deed, Pause) for deed in sent.deeds) == 2
    pedal = ScreenRig(keys=ScreenKeys(stop="e"))
    run(Told(heard(sent, prompt)), Window([], ["escape"], ["e"]), pedal)
    assert sum(isinstance(deed, Pause) for deed in sent.deeds) == 3


def test_a_stop_waits_for_no_page_that_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(screen, "ThreadPoolExecutor", ThreadPoolExecutor)
    goes_on, drawn = threading.Event(), pages.drawn

    def slowly(*asked: Any) -> tuple[Image, int]:
        assert goes_on.wait(60)
        return drawn(*asked)

    monkeypatch.setattr(pages, "drawn", slowly)
    sent, window = Sent(), Window([], ["escape"], [])
    run(Told(heard(sent, Prompt(number=3, show="answer"))), window)
    goes_on.set()
    # Nothing was seen, so nothing is told of a page.
    assert (sent.deeds, window.pictures) == ([Pause()], [])


def test_an_answer_is_chosen_by_its_digit_or_by_touching_its_box_and_nowhere_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(screen, "ANSWER_S", 0.0)
    asking = Prompt(number=4, show="answer", mode="screen", answers=("cork", "felt"), question=9, keys=("c", "f"))
    sent, window = Sent(), Window([], ["2"], ["3", "c", "up"], [], [], [], as_drawn="1")
    first, second = pages.boxes(2, window.size_px)
    inside = (first[0] + 1, (first[1] + first[3]) / 2)
    window.clicks = [[], [], [], [inside], [(5.0, 5.0), ((second[0] + second[2]) / 2, second[3] + 1)], []]
    began_ns = monotonic_ns()
    run(Told(heard(sent, asking)), window)
    chosen = [deed for deed in sent.deeds if isinstance(deed, Choose)]
    assert [untimed(deed) for deed in chosen] == [Choose(question=9, key=key, t_ns=0) for key in "fc"]
    assert all(began_ns <= deed.t_ns <= monotonic_ns() and (deed.error_s or 0) > 0 for deed in chosen)
    assert window.mouse == [True]
