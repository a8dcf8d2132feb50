"""The console in a browser: a visitor's process ends with the server, and the session goes on."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import aiohttp
import pytest

from tests.experiment.protocol.small import SMALL
from tests.working_folder import WorkingFolder

PATIENCE_S = 60.0


@pytest.fixture
def server(tmp_path: Path, working_folder: WorkingFolder) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`palpate run --serve`, and the address of its page; all that it began is gone afterwards."""
    (tmp_path / "small.toml").write_text(SMALL, "utf-8")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [sys.executable, "-P", "-m", "palpate.experiment", "run", "small.toml", "--task", "one", "--practice"]
    environment = {
        **os.environ,
        "XDG_RUNTIME_DIR": str(tmp_path),
        "PYTHONPATH": str(Path(__file__).parents[2]),
        "COLUMNS": "300",
    }
    process = subprocess.Popen(
        [*command, "--serve", "127.0.0.1", "--port", str(port)],
        cwd=tmp_path,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    said = ""
    while (found := re.search(r"http://\S+/\S+/", said)) is None:
        line = process.stdout.readline()
        assert line, said
        said += line
    begun_s = time.monotonic()
    while not listens(port):
        assert time.monotonic() - begun_s < PATIENCE_S
        time.sleep(0.05)
    try:
        yield process, found[0]
    finally:
        for one in begun(tmp_path):
            os.kill(one, signal.SIGKILL)
        process.kill()
        process.wait()
        process.stdout.close()


def listens(port: int) -> bool:
    """Return whether somebody listens at a port of this machine."""
    with socket.socket() as tried:
        return tried.connect_ex(("127.0.0.1", port)) == 0


def consoles(folder: Path) -> list[int]:
    """Return the visitors' consoles."""
    return [one for one in begun(folder, by="--served") if one not in begun(folder, by="--session-at")]


def begun(folder: Path, *, by: str = "") -> list[int]:
    """Return the processes that run for the test in this folder, with these words in their command."""
    found = []
    for one in Path("/proc").iterdir():
        try:
            mine = one.name.isdecimal() and (one / "cwd").readlink() == folder
            words = (one / "cmdline").read_bytes().replace(b"\0", b" ").decode() if mine else ""
        except OSError:
            continue
        if "palpate.experiment" in words and by in words:
            found.append(int(one.name))
    return found


def test_a_visitors_console_ends_with_the_server(server: tuple[subprocess.Popen[str], str], tmp_path: Path) -> None:
    process, address = server
    asyncio.run(seen(process, address, tmp_path))


async def seen(process: subprocess.Popen[str], address: str, folder: Path) -> None:
    async with aiohttp.ClientSession() as browser:
        assert (await browser.get(address)).status == 200
        origin = "/".join(address.split("/")[:3])
        async with browser.ws_connect(f"{address}ws?width=80&height=24", headers={"Origin": origin}) as line:
            drawn = b""
            async with asyncio.timeout(PATIENCE_S):
                while b"small" not in drawn:
                    told = await line.receive()
                    assert told.type in (aiohttp.WSMsgType.BINARY, aiohttp.WSMsgType.TEXT), told
                    drawn += told.data if isinstance(told.data, bytes) else told.data.encode()
            assert consoles(folder)
            process.kill()
            begun_s = time.monotonic()
            while consoles(folder):
                assert time.monotonic() - begun_s < PATIENCE_S
                await asyncio.sleep(0.1)
            # The session goes on.
            assert begun(folder, by="--session-at")
