"""The console in a browser: one page for whoever has its address, which holds a secret; nobody else gets anything.

The page is open to this machine alone unless another address of it is named. What travels is not encrypted, so that
from elsewhere it is best reached through an ssh tunnel.
"""

import hmac
import ipaddress
import secrets
import shlex
from collections.abc import Awaitable, Callable, Sequence

from aiohttp import web
from textual_serve.server import Server

from palpate.experiment.errors import LinkError

LOOPBACK = "127.0.0.1"

COOKIE = "palpate"

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
    """Serves a command's screen to whoever shows the secret: first in the address, then in a cookie of the browser."""

    def __init__(self, command: Sequence[str], *, host: str, port: int, secret: str) -> None:
        """Serve at an address and a port of this machine."""
        # No shell stays between, so that the console knows by its parent whether the server is there.
        super().__init__(f"exec {shlex.join(command)}", host=host, port=port, title="palpate")
        self._secret = secret

    @property
    def address(self) -> str:
        """The address of the page, with the secret."""
        return f"{self.public_url}/?token={self._secret}"

    def initialize_logging(self) -> None:
        """Log nothing: a line for each visit would hold the secret."""

    async def on_startup(self, app: web.Application) -> None:  # noqa: ARG002
        """Say where the page is."""
        self.console.print(f"The console is at {self.address}", soft_wrap=True, markup=False, highlight=False)
        self.console.print("Whoever has this address can give commands. Ctrl-C closes the page; the session goes on.")

    async def _make_app(self) -> web.Application:
        app = await super()._make_app()
        app.middlewares.append(self._only_with_secret)
        return app

    @web.middleware
    async def _only_with_secret(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        shown = request.query.get("token")
        # Of a page of this server, if it comes from a page.
        is_ours = request.headers.get("Origin", self.public_url) == self.public_url
        if shown is not None and self._is_secret(shown) and request.path == "/":
            # Out of the address, so that it stands in no history and no picture of the screen.
            answer: web.StreamResponse = web.Response(status=302, headers={"Location": "/"})
            answer.set_cookie(COOKIE, self._secret, httponly=True, samesite="Strict")
        elif self._is_secret(request.cookies.get(COOKIE, "")) and is_ours:
            answer = await handler(request)
        else:
            answer = web.Response(status=403, text="This page opens only with the address that palpate printed.\n")
        if not answer.prepared:
            answer.headers["Content-Security-Policy"] = POLICY
            answer.headers["Referrer-Policy"] = "no-referrer"
            answer.headers["Cache-Control"] = "no-store"
        return answer

    def _is_secret(self, shown: str) -> bool:
        return hmac.compare_digest(shown.encode(), self._secret.encode())


def served(command: Sequence[str], *, host: str = LOOPBACK, port: int = 8000) -> Served:
    """Return what serves a command's screen at an address of this machine; `.serve()` waits until Ctrl-C.

    Raises `LinkError` for what is no single address: a page that is open everywhere is opened by nobody on purpose.
    """
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        address = None
    if address is None or address.is_unspecified or address.is_multicast or address.version != 4:
        raise LinkError(
            f"got {host!r} as the address of the console's page; allowed: one IPv4 address of this machine, such as "
            f"{LOOPBACK}; name one"
        )
    return Served(command, host=host, port=port, secret=secrets.token_urlsafe(32))
