"""The socket between a session and its consoles: who may open it, what it survives, and that it never waits."""

from __future__ import annotations

import hmac
import os
import socket
import stat
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, closing, suppress
from itertools import count
from pathlib import Path
from queue import SimpleQueue
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.experiment.apparatus import host
from palpate.experiment.desk import link
from palpate.experiment.desk.console import transport
from palpate.experiment.desk.link import Line, Link, from_console
from palpate.experiment.desk.link.wire import Command, Deed, Hello, Pause, Reply, View, line
from palpate.experiment.desk.messages import Gauges, Message, TakeNote
from palpate.experiment.errors import LinkError
from tests.approved import Refuses

ME = Hello(role="console", by="test")


class Session:
    """Implements `SessionEnd`: takes notes, refuses pauses, and shows what it is told to."""

    def __init__(self) -> None:
        self.view = View(study="small")
        self.taken: list[tuple[str, Deed]] = []
        self.consoles = threading.Semaphore(0)
        self.gone: Future[str] = Future()

    def message(self, role: str) -> Message:
        assert role == "console"
        return self.view

    def take(self, hello: Hello, deed: Deed) -> tuple[bool, str] | Future[tuple[bool, str]]:
        self.taken.append((hello.by, deed))
        return isinstance(deed, TakeNote), "so it is"

    def came(self, consoles: int, screens: int) -> None:
        if consoles:
            self.consoles.release()

    def lost(self, why: str) -> None:
        self.gone.set_result(why)


@pytest.fixture
def session() -> Session:
    return Session()


@pytest.fixture
def listening(session: Session, tmp_path: Path) -> Iterator[Link]:
    with closing(Link(tmp_path / "s", session)) as opened:
        yield opened


def views(there: Line) -> Iterator[View]:
    return (message for message in there.messages() if isinstance(message, View))


def test_a_console_catches_up_with_the_first_line_and_learns_what_changes(
    session: Session, listening: Link, tmp_path: Path
) -> None:
    session.view = View(study="small", trial=3)
    with closing(Line(tmp_path / "s", ME)) as there:
        seen = views(there)
        assert next(seen).trial == 3
        session.view = View(study="small", trial=4)
        listening.wake()
        assert next(seen).trial == 4


def test_every_command_is_answered_under_its_number(session: Session, listening: Link, tmp_path: Path) -> None:
    with closing(Line(tmp_path / "s", ME)) as there:
        sent = [there.send(TakeNote(text="Coughs.")), there.send(Pause())]
        said = (message for message in there.messages() if isinstance(message, Reply))
        assert [next(said), next(said)] == [
            Reply(id=sent[0], taken=True, words="so it is"),
            Reply(id=sent[1], taken=False, words="so it is"),
        ]
    assert session.taken == [("test", TakeNote(text="Coughs.")), ("test", Pause())]


def test_only_its_owner_may_open_it(listening: Link, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert stat.S_IMODE((tmp_path / "s").stat().st_mode) == 0o600
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    folder = transport.place(tmp_path / "dataset", "01").parent
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    folder.chmod(0o750)
    other = transport.place(tmp_path / "dataset", "01").parent
    assert (other != folder, stat.S_IMODE(other.stat().st_mode)) == (True, 0o700)


@pytest.fixture
def short_path() -> Iterator[Path]:
    """A folder whose path leaves room for a socket's name, which may have some hundred characters."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


@pytest.mark.parametrize("taken", ["a folder of others", "a file", "a link"])
def test_a_name_that_another_user_took_locks_nobody_out(
    short_path: Path, monkeypatch: pytest.MonkeyPatch, taken: str
) -> None:
    tmp_path = short_path
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    usual = tmp_path / f"palpate-{os.getuid()}"
    mine = tmp_path / "elsewhere"
    mine.mkdir(mode=0o700)
    if taken == "a folder of others":
        usual.mkdir(mode=0o777)
        usual.chmod(0o777)
    elif taken == "a file":
        usual.touch()
    else:
        usual.symlink_to(mine)
    place = transport.place(tmp_path / "dataset", "01")
    assert place.parent not in (usual, mine)
    assert place.parent.stat().st_mode & 0o077 == 0
    with closing(Link(place, Session())):
        # Both ends find the same folder, and a folder of somebody else in between changes nothing.
        (tmp_path / f"{usual.name}-0").mkdir(mode=0o755)
        assert transport.answers(transport.place(tmp_path / "dataset", "01"))
        if taken == "a file":
            usual.unlink()
            assert transport.answers(transport.place(tmp_path / "dataset", "01"))


def test_a_folder_in_which_nothing_can_be_made_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "gone"))
    with pytest.raises(LinkError, match="XDG_RUNTIME_DIR"):
        transport.place(tmp_path / "dataset", "01")


def test_each_session_has_a_place_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    places = {transport.place(tmp_path / dataset, who) for dataset in ("a", "b") for who in ("01", "02")}
    assert len(places) == 4
    assert transport.place(tmp_path / "a", "01") in places


def test_one_session_listens_at_a_place_and_what_a_killed_one_left_is_replaced(
    session: Session, listening: Link, tmp_path: Path, refuses: Refuses
) -> None:
    with refuses(LinkError):
        Link(tmp_path / "s", session)
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(tmp_path / "left"))
    assert not transport.answers(tmp_path / "left")
    with closing(Link(tmp_path / "left", session)):
        assert transport.answers(tmp_path / "left")
    assert not (tmp_path / "left").exists()
    with pytest.raises(LinkError, match="no session is"):
        Line(tmp_path / "left", ME)


def test_a_console_that_does_not_read_holds_nobody_up(session: Session, listening: Link, tmp_path: Path) -> None:
    with closing(Line(tmp_path / "s", ME)), closing(Line(tmp_path / "s", ME)) as there:
        seen = views(there)
        for trial in range(200):
            session.view = View(study="x" * 10_000, trial=trial)
            listening.wake()
            while next(seen).trial != trial:
                pass


def test_a_console_that_stops_reading_is_away_until_it_reads_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a process does that was stopped: its connection stays open."""
    there: SimpleQueue[int] = SimpleQueue()

    class Counted(Session):
        def came(self, consoles: int, screens: int) -> None:
            there.put(consoles)

        def message(self, role: str) -> Message:
            return View(study="x" * 30_000, trial=next(numbers))

    numbers = count()
    monkeypatch.setattr(link, "AWAY_S", 0.2)
    with closing(Link(tmp_path / "s", Counted())) as listening, closing(Line(tmp_path / "s", ME)) as stopped:
        for _ in range(100):
            listening.wake()
        assert [there.get(timeout=10) for _ in range(2)] == [1, 0]
        seen = views(stopped)
        while there.empty():
            next(seen)
        assert there.get() == 1


def test_a_reply_that_waits_for_a_disk_holds_up_nothing_else(tmp_path: Path) -> None:
    waits: Future[tuple[bool, str]] = Future()

    class Waiting(Session):
        def take(self, hello: Hello, deed: Deed) -> tuple[bool, str] | Future[tuple[bool, str]]:
            return waits if isinstance(deed, TakeNote) else (True, "at once")

    session = Waiting()
    with closing(Link(tmp_path / "s", session)) as listening, closing(Line(tmp_path / "s", ME)) as there:
        said = there.messages()
        first, second = there.send(TakeNote(text="hangs")), there.send(Pause())
        assert next(m for m in said if isinstance(m, Reply)) == Reply(id=second, taken=True, words="at once")
        session.view = View(study="small", trial=7)
        listening.wake()
        assert next(m for m in said if isinstance(m, View) and m.trial == 7)
        waits.set_result((True, "on disk"))
        assert next(m for m in said if isinstance(m, Reply)) == Reply(id=first, taken=True, words="on disk")


def test_who_waits_for_a_disk_hears_of_it_before_the_session_is_gone(tmp_path: Path) -> None:
    waits: Future[tuple[bool, str]] = Future()

    class Waiting(Session):
        def take(self, hello: Hello, deed: Deed) -> tuple[bool, str] | Future[tuple[bool, str]]:
            self.consoles.release()
            return waits

    session = Waiting()
    listening = Link(tmp_path / "s", session)
    with closing(Line(tmp_path / "s", ME)) as there:
        assert session.consoles.acquire(timeout=10)
        there.send(TakeNote(text="hangs"))
        assert session.consoles.acquire(timeout=10)
        closes = threading.Thread(target=listening.close)
        closes.start()
        waits.set_result((True, "on disk"))
        assert [m.words for m in there.messages() if isinstance(m, Reply)] == ["on disk"]
        closes.join(10)


@pytest.mark.parametrize(
    "said",
    [
        b"\n",
        b"{}\n",
        b"\xff\n",
        line(ME) + line(ME),
        b"x" * 200_000,
        line(ME) + b'{"kind":"command","id":1,"deed":{"do":"answer"}}\n',
        b'{"kind":"command","id":1,"deed":{"do":"stop"}}\n',
    ],
)
def test_who_talks_nonsense_is_cut_off_and_nobody_else(
    session: Session, listening: Link, tmp_path: Path, said: bytes
) -> None:
    with socket.socket(socket.AF_UNIX) as other, closing(Line(tmp_path / "s", ME)) as there:
        other.connect(str(tmp_path / "s"))
        other.settimeout(10)
        with suppress(OSError):
            other.sendall(said)
        with suppress(OSError):
            while other.recv(65536):
                pass
        there.send(TakeNote(text="Still here."))
        assert any(isinstance(message, Reply) and message.taken for message in there.messages())


def test_the_last_state_is_told_before_the_session_is_gone(session: Session, tmp_path: Path, refuses: Refuses) -> None:
    listening = Link(tmp_path / "s", session)
    with closing(Line(tmp_path / "s", ME)) as there:
        assert session.consoles.acquire(timeout=10)
        session.view = View(study="small", state="ended")
        listening.close()
        assert [view.state for view in views(there)][-1] == "ended"
        with refuses(LinkError):
            for _ in range(100):
                there.send(Pause())


@pytest.mark.parametrize("at_fault", ["message", "take"])
def test_a_fault_of_the_sessions_end_is_seen_by_consoles_and_told_to_the_session(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at_fault: str
) -> None:
    listening = Link(tmp_path / "s", session)
    with closing(Line(tmp_path / "s", ME)) as there:
        assert session.consoles.acquire(timeout=10)

        def fail(*_: object) -> Message:
            raise ZeroDivisionError("a driver's own")

        monkeypatch.setattr(session, at_fault, fail)
        with suppress(LinkError):
            there.send(Pause())
        for _ in there.messages():
            pass
    assert session.gone.result(10) == "ZeroDivisionError: a driver's own"
    assert not transport.answers(tmp_path / "s")
    # Another session may have the place already when this one closes.
    with closing(Link(tmp_path / "s", Session())):
        listening.close()
        assert transport.answers(tmp_path / "s")


def test_who_has_a_reply_to_get_is_told_the_last_state_after_it(tmp_path: Path) -> None:
    go = threading.Event()

    class Slow(Session):
        def take(self, hello: Hello, deed: Deed) -> tuple[bool, str]:
            self.consoles.release()
            assert go.wait(10)
            return True, ""

    slow = Slow()
    listening = Link(tmp_path / "s", slow)
    with closing(Line(tmp_path / "s", ME)) as there:
        assert slow.consoles.acquire(timeout=10)
        there.send(Pause())
        assert slow.consoles.acquire(timeout=10)
        # The next command is read in the closing round.
        there.send(Pause())
        slow.view = View(study="small", state="ended")
        listening._closing = True
        go.set()
        closes = threading.Thread(target=listening.close)
        closes.start()
        said = list(there.messages())
        closes.join()
    assert sum(isinstance(message, Reply) for message in said) == 2
    assert isinstance(said[-1], View)
    assert said[-1].state == "ended"


@settings(max_examples=200)
@given(st.binary(max_size=300) | st.text(max_size=100).map(str.encode))
def test_any_line_is_understood_or_refused(text: bytes) -> None:
    with suppress(LinkError):
        from_console(text)


def test_a_view_with_everything_fits_into_a_message() -> None:
    full = View(lines=("x" * 400,) * 50, gauges=Gauges(left_s=1.0, trace=(123.4,) * 60))
    assert len(line(full)) < 65_536


def test_the_thread_that_a_console_waits_for_waits_less_for_other_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    favoured: Future[str] = Future()
    monkeypatch.setattr(host, "favour", lambda: favoured.set_result(threading.current_thread().name))
    with closing(Link(tmp_path / "s", Session())):
        assert favoured.result(10) == "desk"


@pytest.fixture
def without_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """A system whose sockets are no files."""
    there = {name: value for name, value in vars(socket).items() if name != "AF_UNIX"}
    monkeypatch.setattr(transport, "socket", SimpleNamespace(**there))


@pytest.mark.usefixtures("without_files")
def test_without_socket_files_a_console_comes_by_a_port_of_this_machine(session: Session, tmp_path: Path) -> None:
    with closing(Link(tmp_path / "s", session)) as listening:
        assert listening._server.getsockname()[0] == "127.0.0.1"
        assert stat.S_IMODE((tmp_path / "s").stat().st_mode) == 0o600
        assert transport.answers(tmp_path / "s")
        with pytest.raises(LinkError):
            Link(tmp_path / "s", session)
        with closing(Line(tmp_path / "s", ME)) as there:
            assert next(views(there)).study == "small"
            there.send(TakeNote(text="Coughs."))
            assert any(isinstance(message, Reply) and message.taken for message in there.messages())
    assert not (tmp_path / "s").exists()
    with pytest.raises(LinkError):
        Line(tmp_path / "s", ME)


def said_at(port: int, said: bytes) -> bytes:
    """What is heard at a port by whoever says this."""
    heard = b""
    with socket.create_connection(("127.0.0.1", port)) as other, suppress(OSError):
        other.settimeout(5)
        other.sendall(said)
        while more := other.recv(4096):
            heard += more
    return heard


@pytest.mark.usefixtures("without_files")
@pytest.mark.parametrize("wrong", ["nothing", "another", "the secret", "its text"])
def test_who_does_not_show_the_secret_is_neither_heard_nor_told(session: Session, tmp_path: Path, wrong: str) -> None:
    asked = line(ME) + line(Command(id=1, deed=TakeNote(text="Coughs.")))
    with closing(Link(tmp_path / "s", session)):
        port, _, secret = (tmp_path / "s").read_text("ascii").partition(" ")
        shown = {
            "nothing": b"",
            "another": bytes(2 * transport.SECRET),
            "the secret": bytes(transport.SECRET) + bytes.fromhex(secret),
            "its text": secret.encode(),
        }
        # What it shows of itself is of no use without the secret.
        assert not said_at(int(port), shown[wrong] + asked)[2 * transport.SECRET :]
    assert session.taken == []


@pytest.mark.usefixtures("without_files")
def test_a_session_says_nothing_of_what_it_heard_from_a_console_again(session: Session, tmp_path: Path) -> None:
    with closing(Link(tmp_path / "s", session)):
        _, secret = transport._port_of(tmp_path / "s")
        port = int((tmp_path / "s").read_text("ascii").split()[0])
        nonce = bytes(transport.SECRET)
        with socket.create_connection(("127.0.0.1", port)) as there:
            there.settimeout(10)
            there.sendall(nonce)
            theirs = transport._exactly(there)
            shown = transport._exactly(there)
            assert shown == transport.shown_by(secret, b"session", nonce + theirs)
            # What the session showed is not what a console has to show.
            there.sendall(shown + line(ME))
            with suppress(OSError):
                assert there.recv(1) == b""
        # Nor is what a console showed of use at the next connection.
        again = nonce + transport.shown_by(secret, b"console", nonce + theirs)
        assert not said_at(port, again + line(ME))[2 * transport.SECRET :]


@pytest.mark.usefixtures("without_files")
def test_strangers_take_no_more_than_their_places(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link, "AWAY_S", 60.0)
    with ExitStack() as opened:
        listening = opened.enter_context(closing(Link(tmp_path / "s", session)))
        port = int((tmp_path / "s").read_text("ascii").split()[0])
        for _ in range(link.MOST_STRANGERS):
            opened.enter_context(socket.create_connection(("127.0.0.1", port)))
        more = opened.enter_context(socket.create_connection(("127.0.0.1", port)))
        more.settimeout(30)
        with suppress(ConnectionError):
            assert more.recv(1) == b""
        assert len(listening._peers) == link.MOST_STRANGERS


def test_a_console_that_cannot_be_taken_in_ends_no_link(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fails = iter([OSError(24, "too many open files")])

    class Full(socket.socket):
        def accept(self) -> tuple[socket.socket, object]:
            for error in fails:
                raise error
            return super().accept()

    monkeypatch.setattr(transport, "socket", SimpleNamespace(**{**vars(socket), "socket": Full}))
    with closing(Link(tmp_path / "s", session)), closing(Line(tmp_path / "s", ME)):
        assert session.consoles.acquire(timeout=10)
        assert next(fails, None) is None
        assert not session.gone.done()


@pytest.mark.usefixtures("without_files")
def test_a_port_that_another_program_has_by_now_is_no_sessions(session: Session, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        (tmp_path / "s").write_text(f"{other.getsockname()[1]} {'00' * transport.SECRET}", "ascii")

        heard: SimpleQueue[bytes] = SimpleQueue()

        def echo(makes: Callable[[bytes], bytes]) -> None:
            with suppress(OSError):
                connection, _ = other.accept()
                with connection:
                    heard.put(said := connection.recv(4096))
                    connection.sendall(makes(said))

        for makes in (
            bytes,
            lambda said: said + said,
            lambda said: hmac.digest(said, b"a session of palpate", "sha256"),
            lambda said: said + hmac.digest(said, b"session" + said + said, "sha256"),
        ):
            threading.Thread(target=echo, args=(makes,), daemon=True).start()
            assert not transport.answers(tmp_path / "s")
            assert bytes(transport.SECRET) not in heard.get(timeout=10)
    (tmp_path / "s").write_text("nothing of palpate's", "ascii")
    assert not transport.answers(tmp_path / "s")
    with closing(Link(tmp_path / "s", session)):
        assert transport.answers(tmp_path / "s")
