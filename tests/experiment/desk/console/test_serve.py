"""The console's page: who gets it, and who does not."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest
from aiohttp.test_utils import TestClient, TestServer
from textual_serve.app_service import AppService

from palpate.experiment.desk.console.serve import LOOPBACK, MOST_CELLS, served
from palpate.experiment.errors import LinkError
from tests.approved import Refuses

PATHS = ("", "ws", "static/js/textual.js", "download/x", "nothing")


def visit(then: Callable[[TestClient, str], Awaitable[None]]) -> None:  # type: ignore[type-arg]
    """Visit the page of a command that nobody may start, with its secret."""

    async def run() -> None:
        page = served(["false"], port=8000)
        secret = page.address.split("/")[3]
        async with TestClient(TestServer(await page._make_app())) as client:
            await then(client, secret)

    asyncio.run(run())


def test_nobody_without_the_secret_gets_anything() -> None:
    async def then(client: TestClient, secret: str) -> None:  # type: ignore[type-arg]
        for path in PATHS:
            for shown in ("", "wrong/", f"{secret[:-1]}/", f"{secret}x/", "ä/", f"x/{secret}/", f"?token={secret}"):
                answer = await client.get(f"/{shown}{path}", cookies={"palpate": secret}, allow_redirects=False)
                assert (answer.status, shown, path) == (403, shown, path)
                assert secret not in await answer.text()

    visit(then)


def test_the_address_opens_the_page_and_no_cookie_carries_the_secret_to_other_ports() -> None:
    async def then(client: TestClient, secret: str) -> None:  # type: ignore[type-arg]
        page = await client.get(f"/{secret}/")
        assert page.status == 200
        assert "Set-Cookie" not in page.headers
        assert f"{page.url.path}ws" in await page.text()
        assert (await client.get(f"/{secret}/{PATHS[2]}")).status == 200
        # Nothing is fetched from anywhere else, whatever the page names, and no other page is told the address.
        assert page.headers["Content-Security-Policy"].startswith("default-src 'self';")
        assert (page.headers["Referrer-Policy"], page.headers["Cache-Control"]) == ("no-referrer", "no-store")

    visit(then)


@pytest.mark.parametrize("size", ["999999999", "0", "-1", "1001", "x", "1e9", "9" * 5000])
def test_no_screen_is_larger_than_a_screen_can_be(size: str) -> None:
    async def then(client: TestClient, secret: str) -> None:  # type: ignore[type-arg]
        for side in ("width", "height"):
            assert (await client.get(f"/{secret}/ws", params={side: size})).status == 400

    visit(then)


def test_a_size_that_no_screen_has_reaches_no_console(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: list[tuple[int, int]] = []

    async def start(_service: AppService, width: int, height: int) -> None:
        sizes.append((width, height))

    async def resized(_service: AppService, width: int, height: int) -> None:
        sizes.append((width, height))

    async def stop(_service: AppService) -> None:
        pass

    for name, act in (("start", start), ("set_terminal_size", resized), ("stop", stop)):
        monkeypatch.setattr(AppService, name, act)

    async def then(client: TestClient, secret: str) -> None:  # type: ignore[type-arg]
        async with client.ws_connect(f"/{secret}/ws?width=100&height=30") as browser:
            for width, height in ((999_999_999, 30), (100, 10**30), (0, 0), (120, 40), (MOST_CELLS, 1)):
                await browser.send_json(["resize", {"width": width, "height": height}])
            await browser.send_json(["ping", "1"])
            assert await browser.receive_json(timeout=10) == ["pong", "1"]
        assert sizes == [(100, 30), (120, 40), (MOST_CELLS, 1)]

    visit(then)


def test_a_page_of_somebody_else_gets_no_keys() -> None:
    async def then(client: TestClient, secret: str) -> None:  # type: ignore[type-arg]
        stranger = {"Origin": "http://example.org"}
        assert (await client.get(f"/{secret}/ws", headers=stranger)).status == 403

    visit(then)


def test_every_secret_is_another() -> None:
    assert len({served(["false"]).address for _ in range(50)}) == 50
    assert served(["false"]).address.startswith(f"http://{LOOPBACK}:8000/")


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "::1", "", "localhost", "224.0.0.1", "example.org", "127.0.0.1/8"])
def test_it_is_not_open_everywhere_by_a_slip(host: str, refuses: Refuses) -> None:
    with refuses(LinkError):
        served(["false"], host=host)
