"""The console in a browser: one page for whoever has its address, which begins with a secret.

A cookie would go to every port of this machine, other users' too. Unless another address is named, the page is open to
this machine alone; nothing is encrypted, so use an ssh tunnel from elsewhere.
"""

import hmac
import ipaddress
import secrets
import shlex
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from typing import Any, cast

from aiohttp import WSMessage, WSMsgType, web
from textual_serve.app_service import AppService
from textual_serve.server import Server

from palpate.experiment.errors import LinkError

LOOPBACK = "127.0.0.1"

MOST_CELLS = 1_000
"""No screen of a browser has more columns or lines: the console keeps memory for each of its cells."""

POLICY = "; ".join(
    (
        "default-src 'self'",
        "style-src 'self' 'unsafe-inline'",
        "script-src 'self' 'unsafe-inline'",
        "connect-src 'self' ws:",
        "font-src 'self' data:",
        "img-src 'self' data:",
        "frame-ancestors 'none'",
    )
)
"""The page fetches nothing from anywhere else."""


class Served(Server):
    """Serves a command's screen to whoever shows the secret in the path."""

    def __init__(self, command: Sequence[str], *, host: str, port: int, secret: str) -> None:
        """Serve at an address and a port of this machine."""
        # No shell stays between, so that the console knows by its parent whether the server is there.
        super().__init__(f"exec {shlex.join(command)}", host=host, port=port, title="palpate")
        self._secret = secret

    @property
    def address(self) -> str:
        """The address of the page, with the secret."""
        return f"{self.public_url}/{self._secret}/"

    def initialize_logging(self) -> None:
        """Log nothing: a line for each visit would hold the secret."""

    async def on_startup(self, app: web.Application) -> None:  # noqa: ARG002
        """Say where the page is."""
        self.console.print(f"The console is at {self.address}", soft_wrap=True, markup=False, highlight=False)
        self.console.print("Anyone with this address can give commands. Ctrl-C closes the page; the session continues.")

    async def _make_app(self) -> web.Application:
        app = web.Application(middlewares=[self._only_with_secret])
        app.add_subapp(f"/{self._secret}/", await super()._make_app())
        return app

    async def _process_messages(self, websocket: web.WebSocketResponse, app_service: AppService) -> None:
        await super()._process_messages(cast("web.WebSocketResponse", _Bounded(websocket)), app_service)

    @web.middleware
    async def _only_with_secret(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        # Of a page of this server, if it comes from a page.
        is_ours = request.headers.get("Origin", self.public_url) == self.public_url
        if not (self._is_secret(request.path.split("/")[1]) and is_ours):
            answer: web.StreamResponse = web.Response(
                status=403, text="This page opens only with the address that palpate printed.\n"
            )
        elif not all(_is_size(request.query.get(side, "80")) for side in ("width", "height")):
            answer = web.Response(status=400, text=f"A screen has 1 to {MOST_CELLS} columns and lines.\n")
        else:
            answer = await handler(request)
        if not answer.prepared:
            answer.headers["Content-Security-Policy"] = POLICY
            answer.headers["Referrer-Policy"] = "no-referrer"
            answer.headers["Cache-Control"] = "no-store"
        return answer

    def _is_secret(self, shown: str) -> bool:
        return hmac.compare_digest(shown.encode(), self._secret.encode())


class _Bounded:
    """What a browser sends, without sizes that no screen has."""

    def __init__(self, websocket: web.WebSocketResponse) -> None:
        self._websocket = websocket
        self.send_json = websocket.send_json

    async def __aiter__(self) -> AsyncIterator[WSMessage]:
        async for message in self._websocket:
            envelope: Any = message.json() if message.type is WSMsgType.TEXT else [""]
            if envelope[0] != "resize" or all(_is_size(envelope[1][side]) for side in ("width", "height")):
                yield message


def _is_size(cells: object) -> bool:
    return str(cells).isascii() and str(cells).isdecimal() and 1 <= int(str(cells)[:9]) <= MOST_CELLS


def served(command: Sequence[str], *, host: str = LOOPBACK, port: int = 8000) -> Served:
    """Return what serves a command's screen at an address of this machine; `.serve()` waits until Ctrl-C.

    Raises `LinkError` unless it is a single address.
    """
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        address = None
    if address is None or address.is_unspecified or address.is_multicast or address.version != 4:
        raise LinkError(
            f"got {host!r} as the address for the console's page",
            remedy="use one",
            allowed=f"one IPv4 address of this machine, such as {LOOPBACK}",
        )
    return Served(command, host=host, port=port, secret=secrets.token_urlsafe(32))
