"""A TOML language server, as editors start it, on files with our schemas: what it completes, shows and marks."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from palpate.experiment.protocol.files import shipped
from tests.conftest import Palpate

Ask = Callable[[str, dict[str, Any]], Any]
"""Method, parameters -> what the server replies."""

PROTOCOLS, RIGS = ("okamoto2012", "wellman1995"), ("rehearsal", "tapping", "headless", "laboratory")


@pytest.fixture(scope="session")
def tombi() -> str:
    found = shutil.which("tombi", path=str(Path(sys.executable).parent))
    if found is None:
        pytest.skip("needs the TOML language server (pip install tombi)")
    return found


@pytest.fixture
def schemas(tmp_path: Path, palpate: Palpate) -> Path:
    for of in ("protocol", "rig"):
        for _ in range(2):
            code, out, _ = palpate("schema", of, "--out", tmp_path / f"{of}.schema.json")
            assert (code, f"#:schema {of}.schema.json" in out) == (0, True)
    return tmp_path


@pytest.fixture
def ask(tombi: str, schemas: Path) -> Iterator[Ask]:
    """Ask a server that was started in the folder with the schemas."""
    with subprocess.Popen([tombi, "lsp", "--offline"], stdin=-1, stdout=-1, stderr=-3, cwd=schemas) as server:
        assert server.stdin is not None
        assert server.stdout is not None
        pipe_in, pipe_out, number = server.stdin, server.stdout, 0

        def send(message: dict[str, Any]) -> None:
            body = json.dumps({"jsonrpc": "2.0", **message}).encode()
            pipe_in.write(b"Content-Length: %d\r\n\r\n" % len(body) + body)
            pipe_in.flush()

        def read() -> dict[str, Any]:
            length = 0
            while line := pipe_out.readline().strip():
                if line.lower().startswith(b"content-length:"):
                    length = int(line.split(b":")[1])
            found: dict[str, Any] = json.loads(pipe_out.read(length))
            return found

        def asked(method: str, parameters: dict[str, Any]) -> Any:
            nonlocal number
            if method.startswith("textDocument/did") or method == "initialized":
                return send({"method": method, "params": parameters})
            number += 1
            send({"id": number, "method": method, "params": parameters})
            while True:
                reply = read()
                if "method" in reply and "id" in reply:
                    send({"id": reply["id"], "result": [None]})
                elif reply.get("id") == number:
                    return reply["result"]

        root = schemas.as_uri()
        asked("initialize", {"processId": None, "rootUri": root, "capabilities": {"textDocument": {"diagnostic": {}}}})
        asked("initialized", {})
        yield asked
        server.kill()


def _opened(ask: Ask, file: Path, text: str) -> dict[str, str]:
    document = {"uri": file.as_uri()}
    file.write_text(text, "utf-8")
    ask("textDocument/didOpen", {"textDocument": {**document, "languageId": "toml", "version": 1, "text": text}})
    while ask("textDocument/documentSymbol", {"textDocument": document}) is None:
        time.sleep(0.01)  # the server replies to what comes after a document before it has opened it
    return document


def _marked(ask: Ask, document: dict[str, str]) -> dict[int, str]:
    """Return the lines, from 1, at which something is marked, and why."""
    found = ask("textDocument/diagnostic", {"textDocument": document})["items"]
    return {one["range"]["start"]["line"] + 1: one["code"] for one in found if one["severity"] == 1}


def test_nothing_is_marked_in_what_comes_with_palpate(ask: Ask, schemas: Path) -> None:
    files = [(name, "protocol") for name in PROTOCOLS] + [(f"rigs/{name}", "rig") for name in RIGS]
    for name, of in files:
        text = shipped(f"{name}.toml").read_text("utf-8").removeprefix("#:schema rig.schema.json\n")
        file = schemas / f"{Path(name).name}.toml"
        assert _marked(ask, _opened(ask, file, f"#:schema {of}.schema.json\n{text}")) == {}


def test_an_unknown_key_a_wrong_value_and_a_wrong_type_are_marked_where_they_stand(ask: Ask, schemas: Path) -> None:
    text = f"#:schema protocol.schema.json\n{shipped('okamoto2012.toml').read_text('utf-8')}"
    lines = set()
    for old, new in (
        ('noise = "pink"', 'noise = "blue"'),
        ("session_min = ", "session_min = true#"),
        ("shortest_min", "shortest"),
    ):
        before, after = re.split(f"^{old}", text, flags=re.MULTILINE)
        lines.add(before.count("\n") + 1)
        text = f"{before}{new}{after}"
    marked = _marked(ask, _opened(ask, schemas / "study.toml", text))
    assert lines <= marked.keys()
    assert len(marked) <= len(lines) + 1  # a missing key is marked at its table


def test_a_new_study_names_its_schema_and_keys_are_completed_with_their_meaning(
    ask: Ask, schemas: Path, palpate: Palpate, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(schemas)
    assert palpate("new", "mine.toml", "--yes", "--rig", "myrig.toml")[0] == 0
    text = (schemas / "mine.toml").read_text("utf-8")
    assert _marked(ask, _opened(ask, schemas / "mine.toml", text)) == {}
    rig = (schemas / "myrig.toml").read_text("utf-8")
    assert _marked(ask, _opened(ask, schemas / "myrig.toml", rig)) == {}
    begun = "#:schema protocol.schema.json\n[masker]\n\n"
    document = _opened(ask, schemas / "begun.toml", begun)
    offered = ask("textDocument/completion", {"textDocument": document, "position": {"line": 2, "character": 0}})
    meant = {one["label"]: one["documentation"]["value"] for one in offered}
    assert {"noise", "level_set_by", "criterion", "probe"} <= meant.keys()
    assert "pink" in meant["noise"]
