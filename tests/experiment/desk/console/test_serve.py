"""The console's page: who gets it, and who does not."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest
from aiohttp.test_utils import TestClient, TestServer

from palpate.experiment.desk.console.serve import COOKIE, LOOPBACK, served
from palpate.experiment.errors import LinkError

PATHS = ("/", "/ws", "/static/js/textual.js", "/download/x", "/nothing", "/?token=", "/?token=wrong", "/ws?token=wrong")


def visit(then: Callable[[TestClient, str], Awaitable[None]]) -> None:  # type: ignore[type-arg]
    """Visit the page of a command that nobody may start, with its secret."""

    async def run() -> None:
        page = served(["false"], port=8000)
        secret = page.address.partition("token=")[2]
        async with TestClient(TestServer(await page._make_app())) as client:
            await then(client, secret)

    asyncio.run(run())


def test_nobody_without_the_secret_gets_anything() -> None:
    async def then(client: TestClient, secret: str) -> None:  # type: ignore[type-arg]
        for path in (*PATHS, f"/ws?token={secret}", f"/static/js/textual.js?token={secret}"):
            for cookies in ({}, {COOKIE: ""}, {COOKIE: secret[:-1]}, {COOKIE: f"{secret}x"}, {COOKIE: "ä"}):
                answer = await client.get(path, cookies=cookies, allow_redirects=False)
                assert (answer.status, path) == (403, path)
                assert "token" not in await answer.text()
                assert "Set-Cookie" not in answer.headers
                client.session.cookie_jar.clear()

    visit(then)


def test_the_address_opens_the_page_once_and_the_secret_leaves_it() -> None:
    async def then(client: TestClient, secret: str) -> None:  # type: ignore[type-arg]
        first = await client.get(f"/?token={secret}", allow_redirects=False)
        assert (first.status, first.headers["Location"]) == (302, "/")
        assert "HttpOnly" in first.headers["Set-Cookie"]
        assert "SameSite=Strict" in first.headers["Set-Cookie"]
        page = await client.get("/", cookies={COOKIE: secret})
        assert page.status == 200
        assert secret not in await page.text()
        # Nothing is fetched from anywhere else, whatever the page names.
        assert page.headers["Content-Security-Policy"].startswith("default-src 'self';")

    visit(then)


def test_a_page_of_somebody_else_gets_no_keys() -> None:
    async def then(client: TestClient, secret: str) -> None:  # type: ignore[type-arg]
        stranger = {"Origin": "http://example.org"}
        assert (await client.get("/ws", cookies={COOKIE: secret}, headers=stranger)).status == 403

    visit(then)


def test_every_secret_is_another() -> None:
    assert len({served(["false"]).address for _ in range(50)}) == 50
    assert served(["false"]).address.startswith(f"http://{LOOPBACK}:8000/?token=")


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "::1", "", "localhost", "224.0.0.1", "example.org", "127.0.0.1/8"])
def test_it_is_not_open_everywhere_by_a_slip(host: str) -> None:
    with pytest.raises(LinkError, match="allowed: one IPv4 address of this machine"):
        served(["false"], host=host)
