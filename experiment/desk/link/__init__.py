"""The link between a session and its consoles, by a socket that only this user can reach (`transport`).

The session's end is one thread that waits for no console: a slow one misses views.
"""

import hmac
import secrets
import selectors
import socket
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Protocol

from pydantic import Field, TypeAdapter, ValidationError

from palpate.experiment.apparatus import host
from palpate.experiment.desk import messages
from palpate.experiment.desk.console import transport
from palpate.experiment.desk.link import wire
from palpate.experiment.errors import LinkError
from palpate.experiment.settings import characters

TICK_S = 0.1
"""What is measured is told so often, s."""

HAND_S = 1 / 30
"""And so often while the participant's screen shows the hand, s: as in Wellman and Howe."""

MOST_UNREAD = 1 << 20
"""A console that leaves so much unread is cut off, bytes."""

BEAT_S = 0.5
"""What has not changed for so long is told again, s: whoever hears nothing knows that the session stands still."""

MOST_STRANGERS = 16
"""So many that have not shown that they know the secret may be connected."""

AWAY_S = 5.0
"""One that reads nothing for so long although something is there, as a process does that was stopped, is away, s."""


_FROM_SESSION: TypeAdapter[wire.View | messages.Prompt | wire.Reply] = TypeAdapter(
    Annotated[wire.View | messages.Prompt | wire.Reply, Field(discriminator="kind")]
)
_FROM_CONSOLE: TypeAdapter[wire.Hello | wire.Command] = TypeAdapter(
    Annotated[wire.Hello | wire.Command, Field(discriminator="kind")]
)


class SessionEnd(Protocol):
    """The session's side of the link, called from its thread."""

    def message(self, role: str) -> messages.Message:
        """Return what a console (`console`) or the participant's screen (`screen`) shows now."""

    def take(self, hello: wire.Hello, deed: wire.Deed) -> tuple[bool, str] | Future[tuple[bool, str]]:
        """Return whether a command was taken, and in words what was done, or why not; later, where that takes time."""

    def came(self, consoles: int, screens: int) -> None:
        """Take note of how many consoles and participant's screens are connected now."""

    def lost(self, why: str) -> None:
        """Take note that the link is at fault, and that no console can be reached through it any more."""


class _Peer:
    def __init__(self, connection: socket.socket, secret: bytes) -> None:
        self.connection = connection
        self.secret = secret
        """What it has to know before it is heard; nothing once it has shown that."""
        self.expected = b""
        """What shows that, once it has sent its nonce."""
        self.hello: wire.Hello | None = None
        self.read = bytearray()
        self.unsent = bytearray()
        self.read_s = time.monotonic()
        self.told, self.told_s = b"", 0.0

    @property
    def away(self) -> bool:
        """Whether it stopped reading, or has not shown that it knows the secret."""
        return bool(self.unsent or self.secret) and time.monotonic() - self.read_s > AWAY_S


class Link:
    """Listens at a socket, tells every console what it shows, and hands on what it asks."""

    def __init__(self, path: Path, end: SessionEnd) -> None:
        """Listen from now on. Raises `LinkError` if another session listens there, or if it cannot be made."""
        self._end = end
        self._path = path
        self._peers: list[_Peer] = []
        self._owed: list[tuple[_Peer, int, Future[tuple[bool, str]]]] = []
        self._selector = selectors.DefaultSelector()
        self._there = 0, 0
        self._closing = False
        self._tick_s = TICK_S
        self._server, self._secret = transport.listening(path)
        self._woken, self._wakes = socket.socketpair()
        self._woken.setblocking(False)
        self._wakes.setblocking(False)
        self._selector.register(self._server, selectors.EVENT_READ)
        self._selector.register(self._woken, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._serve, name="desk", daemon=True)
        self._thread.start()

    def wake(self) -> None:
        """Have what changed be told at once."""
        with suppress(OSError):
            self._wakes.send(b"\0")

    def close(self) -> None:
        """Tell the last state, and listen no longer."""
        self._closing = True
        self.wake()
        self._thread.join()
        self._leave()
        for ours in (self._woken, self._wakes):
            ours.close()
        self._selector.close()

    def _leave(self) -> None:
        """Have every console see that the session is gone, and free the place, once."""
        if self._server.fileno() < 0:
            return
        for peer in self._peers:
            peer.connection.close()
        self._server.close()
        self._path.unlink(missing_ok=True)

    def _serve(self) -> None:
        # Whoever keys waits for this thread, and a session for what it holds while another process has its core.
        host.favour()
        try:
            self._listen()
        except Exception as error:
            self._leave()
            self._end.lost(f"{type(error).__name__}: {error}")

    def _listen(self) -> None:
        while True:
            closing = self._closing
            for key, events in self._selector.select(0 if closing and not self._owed else self._tick_s):
                if key.fileobj is self._server:
                    self._accept()
                elif key.fileobj is self._woken:
                    with suppress(BlockingIOError):
                        self._woken.recv(4096)
                elif events & selectors.EVENT_READ:
                    self._hear(key.data)
            self._count()
            self._pay()
            closing = closing and not self._owed
            # Whoever still has a reply to get hears the last state after it.
            for _ in range(2 if closing else 1):
                for peer in tuple(self._peers):
                    self._speak(peer)
            if closing:
                return

    def _accept(self) -> None:
        try:
            connection, _ = self._server.accept()
        except OSError:  # Whoever came has left, or no more files can be open.
            return
        if sum(bool(peer.secret) for peer in self._peers) >= MOST_STRANGERS:
            connection.close()
            return
        connection.setblocking(False)
        peer = _Peer(connection, self._secret)
        self._peers.append(peer)
        self._selector.register(connection, selectors.EVENT_READ, peer)

    def _hear(self, peer: _Peer) -> None:
        try:
            read = peer.connection.recv(transport.SECRET - len(peer.read) if peer.secret else wire.LONGEST)
        except OSError:
            read = b""
        peer.read += read
        if peer.secret and read:
            self._admit(peer)
            return
        *lines, rest = peer.read.split(b"\n")
        peer.read = bytearray(rest)
        if not read or len(rest) > wire.LONGEST:
            self._drop(peer)
            return
        for one in lines:
            try:
                self._obey(peer, from_console(bytes(one)))
            except LinkError:
                self._drop(peer)
                return

    def _admit(self, peer: _Peer) -> None:
        """Show one that sent its nonce that this is the session, and hear it once it has shown the same."""
        if len(peer.read) < transport.SECRET:
            return
        shown, peer.read = bytes(peer.read), bytearray()
        if not peer.expected:
            nonce = secrets.token_bytes(transport.SECRET)
            peer.unsent += nonce + transport.shown_by(peer.secret, b"session", shown + nonce)
            peer.expected = transport.shown_by(peer.secret, b"console", shown + nonce)
            self._speak(peer)
        elif hmac.compare_digest(shown, peer.expected):
            peer.secret = b""
        else:
            self._drop(peer)

    def _obey(self, peer: _Peer, said: wire.Hello | wire.Command) -> None:
        if isinstance(said, wire.Hello):
            if peer.hello is not None:
                raise LinkError("said hello twice")
            peer.hello = said
            return
        if peer.hello is None:
            raise LinkError("said no hello")
        reply = self._end.take(peer.hello, said.deed)
        if isinstance(reply, Future):
            self._owed.append((peer, said.id, reply))
            reply.add_done_callback(lambda _: self.wake())
        else:
            self._reply(peer, said.id, *reply)

    def _pay(self) -> None:
        """Give the replies that were waited for."""
        owed, self._owed = self._owed, []
        for peer, number, reply in owed:
            if reply.done():
                self._reply(peer, number, *reply.result())
            else:
                self._owed.append((peer, number, reply))

    def _reply(self, peer: _Peer, number: int, taken: bool, words: str) -> None:
        peer.unsent += wire.line(wire.Reply(id=number, taken=taken, words=words))

    def _speak(self, peer: _Peer) -> None:
        if peer.secret and peer.away:
            self._drop(peer)
            return
        if peer.hello is not None:
            self._tell(peer, peer.hello.role)
        try:
            while peer.unsent:
                del peer.unsent[: peer.connection.send(peer.unsent)]
                peer.read_s = time.monotonic()
        except BlockingIOError:
            if len(peer.unsent) > MOST_UNREAD:
                self._drop(peer)
        except OSError:
            self._drop(peer)

    def _tell(self, peer: _Peer, role: str) -> None:
        if not peer.unsent:
            peer.read_s = time.monotonic()
        said = self._end.message(role)
        if isinstance(said, messages.Prompt):
            self._tick_s = TICK_S if said.hand_mm is None else HAND_S
        told, now_s = wire.line(said), time.monotonic()
        if not peer.unsent and (told != peer.told or now_s - peer.told_s > BEAT_S):
            peer.told, peer.told_s = told, now_s
            peer.unsent += told

    def _drop(self, peer: _Peer) -> None:
        self._selector.unregister(peer.connection)
        peer.connection.close()
        self._peers.remove(peer)

    def _count(self) -> None:
        roles = [peer.hello.role for peer in self._peers if peer.hello is not None and not peer.away]
        if (there := (roles.count("console"), roles.count("screen"))) != self._there:
            self._there = there
            self._end.came(*there)


class Line:
    """A console's end of the link."""

    def __init__(self, path: Path, hello: wire.Hello) -> None:
        """Connect. Raises `LinkError` if no session listens there."""
        self._lock = threading.Lock()
        self._sent = 0
        self._read = bytearray()
        try:
            self._connection = transport.connect(path)
        except OSError as error:
            raise LinkError(
                f"no session is running at {path} ({error.strerror or error})", remedy="start one"
            ) from error
        # A session that ends just now is found gone by whoever asks it.
        with suppress(OSError):
            self._connection.sendall(wire.line(hello))

    def send(self, deed: wire.Deed) -> int:
        """Send a command, and return its id. Raises `LinkError` if the session is gone."""
        with self._lock:
            self._sent += 1
            try:
                self._connection.sendall(wire.line(wire.Command(id=self._sent, deed=deed)))
            except OSError as error:
                raise LinkError("the session has ended") from error
            return self._sent

    def messages(self) -> Iterator[wire.View | messages.Prompt | wire.Reply]:
        """Yield the session's messages until it is gone, over several calls. Raises `LinkError` for invalid ones."""
        while True:
            said, newline, rest = self._read.partition(b"\n")
            if newline:
                self._read = rest
                yield from_session(bytes(said))
                continue
            try:
                more = self._connection.recv(wire.LONGEST)
            except OSError:
                more = b""
            if not more:
                return
            self._read += more

    def close(self) -> None:
        """Leave; the session goes on."""
        with suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)
        self._connection.close()


def from_session(text: bytes) -> wire.View | messages.Prompt | wire.Reply:
    """Return what a line of a session says. Raises `LinkError`."""
    try:
        return _FROM_SESSION.validate_json(text)
    except ValidationError as error:
        raise _not_understood(text) from error


def from_console(text: bytes) -> wire.Hello | wire.Command:
    """Return what a line of a console says. Raises `LinkError`."""
    try:
        return _FROM_CONSOLE.validate_json(text)
    except ValidationError as error:
        raise _not_understood(text) from error


def _not_understood(text: bytes) -> LinkError:
    shown = characters.quoted(text.decode("utf-8", "replace"))
    return LinkError(
        "the session and its console are different versions", f"got {shown}", "use the same version of palpate for both"
    )
