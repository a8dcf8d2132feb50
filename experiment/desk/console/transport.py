"""Where a session listens for its consoles: a socket that is a file of its user, or a port of this machine.

A system without such sockets has a file in its place, with the port and a secret of 32 bytes. It is for its owner alone
where files can be, and in the user's own folder anywhere. Nobody sends it. Each side sends 32 random bytes; first the
session shows that it knows the secret, and is not a program that came after it, by an HMAC (RFC 2104, SHA-256) of its
role and of both sides' bytes. Nothing else of a console is read before it has shown the same. Nothing is bound but the
loopback address.
"""

import hashlib
import hmac
import os
import re
import secrets
import socket
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.errors import LinkError

LOOPBACK = "127.0.0.1"

SECRET = 32
"""Bytes of a secret, of a nonce, and of what shows that the secret is known."""

PATIENCE_S = 2.0
"""So long a port has to show whose it is, s."""


def place(dataset: Path, participant: str) -> Path:
    """Return a session's place in a folder that only its owner may open. Raises `LinkError` where none is possible."""
    name = hashlib.sha256(f"{dataset.resolve()}\n{participant}".encode()).hexdigest()[:16]
    return _own_folder(Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir())) / f"{name}.sock"


def _own_folder(parent: Path) -> Path:
    """Return the folder of this user's sockets, made if missing. Raises `LinkError` if it cannot be made.

    Another user may have its name in a shared temporary folder; then both ends use another. On a system without users'
    numbers the temporary folder is the user's own.
    """
    has_users = hasattr(os, "getuid")
    usual = parent / f"palpate-{os.getuid() if has_users else 'consoles'}"
    try:
        if not has_users:
            usual.mkdir(exist_ok=True)
            return usual
        if not (usable := _usable(usual)):
            if usual.is_symlink() or usual.exists():
                tempfile.mkdtemp(prefix=f"{usual.name}-", dir=parent)
            else:
                usual.mkdir(mode=0o700)
            usable = _usable(usual)
    except OSError as error:
        raise LinkError(
            parent,
            f"the folder for the link between session and console could not be created ({error.strerror or error})",
            "set XDG_RUNTIME_DIR to one, or run the session with --lines",
            allowed="a folder that you may write to",
        ) from error
    return usable[0]


def _usable(usual: Path) -> list[Path]:
    """Return the folders of this name, or of one that begins with it, that only this user may open."""
    found: list[Path] = []
    for one in (usual, *sorted(usual.parent.glob(f"{usual.name}-*"))):
        with suppress(FileNotFoundError):
            mode = one.lstat()
            if stat.S_ISDIR(mode.st_mode) and mode.st_uid == os.getuid() and not mode.st_mode & 0o077:
                found.append(one)
    return found


def listening(path: Path) -> tuple[socket.socket, bytes]:
    """Return a socket that listens, and the secret that whoever connects has to know: none where it is a file.

    Raises `LinkError` if another session is running there, or if it cannot be made.
    """
    is_file = hasattr(socket, "AF_UNIX")
    server = socket.socket(socket.AF_UNIX if is_file else socket.AF_INET)
    try:
        if path.exists() and not answers(path):
            path.unlink()
        if is_file:
            server.bind(str(path))
            path.chmod(0o600)
        elif path.exists():
            raise FileExistsError(0, "another session is running there")
        else:
            server.bind((LOOPBACK, 0))
        server.listen()
        server.setblocking(False)
        secret = b"" if is_file else secrets.token_bytes(SECRET)
        if not is_file:
            _write_alone(path, f"{server.getsockname()[1]} {secret.hex()}".encode())
    except OSError as error:
        server.close()
        raise LinkError(
            path, error.strerror or str(error), "end the other one", allowed="one session per participant at a time"
        ) from error
    return server, secret


def _write_alone(path: Path, content: bytes) -> None:
    """Write a file that never has another content, and that its owner alone may read where files can be so."""
    partial = path.with_name(f"{path.name}.{secrets.token_hex(8)}")
    with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(content)
    partial.replace(path)


def connect(path: Path) -> socket.socket:
    """Return a connection to the session that listens at a place. Raises `OSError` if none does."""
    is_file = stat.S_ISSOCK(path.stat().st_mode)
    address, secret = (str(path), b"") if is_file else _port_of(path)
    there = socket.socket(socket.AF_UNIX if is_file else socket.AF_INET)
    try:
        # PsychoPy gives every socket of its process a timeout; a session may be silent for longer.
        there.settimeout(PATIENCE_S if secret else None)
        there.connect(address)
        if secret:
            there.sendall(nonce := secrets.token_bytes(SECRET))
            nonces = nonce + _exactly(there)
            if not hmac.compare_digest(_exactly(there), shown_by(secret, b"session", nonces)):
                raise ConnectionRefusedError(0, "another program is using its port")
            there.sendall(shown_by(secret, b"console", nonces))
            there.settimeout(None)
    except OSError:
        there.close()
        raise
    return there


def shown_by(secret: bytes, role: bytes, nonces: bytes) -> bytes:
    """Return what shows that a `session` or a `console` knows the secret, for the console's and the session's nonce."""
    return hmac.digest(secret, role + nonces, "sha256")


def _port_of(path: Path) -> tuple[tuple[str, int], bytes]:
    found = re.fullmatch(rb"([0-9]{1,5}) ([0-9a-f]{64})", storage.read_bytes(path))
    if found is None or int(found[1]) > 65535:
        raise ConnectionRefusedError(0, "a file that palpate did not write is in its place")
    return (LOOPBACK, int(found[1])), bytes.fromhex(found[2].decode())


def _exactly(there: socket.socket) -> bytes:
    shown = b""
    while len(shown) < SECRET and (more := there.recv(SECRET - len(shown))):
        shown += more
    return shown


def answers(path: Path) -> bool:
    """Return whether a session listens at this place."""
    try:
        connect(path).close()
    except OSError:
        return False
    return True
