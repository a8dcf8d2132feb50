"""The site: it is built strictly, what it teaches runs as pasted, and a stranger's question has its answer there."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from palpate.experiment.cli import docs
from tests.figures import PAGES
from tests.measures.source import REPOSITORY

QUESTIONS = 24
"""Of a stranger; each has its anchor, `q1` and so on."""

FETCHED = re.compile(r'<(?:script|link|img)[^>]+(?:src|href)="(?:https?:)?//')
"""What a page would ask another machine for."""

LINES = {"a page": "[one](nothing.md)", "an anchor": "[one](index.md#nothing)", "a picture": "![one](nothing.png)"}


def built(out: Path, root: Path) -> subprocess.CompletedProcess[str]:
    pytest.importorskip("sphinx")
    code = f"from pathlib import Path\nfrom tests.site import build\nbuild(Path({str(out)!r}), Path({str(root)!r}))"
    command = [sys.executable, "-c", code]
    return subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)


def test_every_guide_and_every_answer_is_a_page_of_the_site(tmp_path: Path) -> None:
    done = built(tmp_path / "site", REPOSITORY)
    assert (done.returncode, done.stderr) == (0, "")
    pages = {file.relative_to(tmp_path / "site").as_posix() for file in (tmp_path / "site").rglob("*.html")}
    assert {file.replace(".md", ".html") for file, _ in docs.GUIDES.values()} | {"index.html"} <= pages
    text = (tmp_path / "site" / PAGES / "questions.html").read_text("utf-8")
    assert [f"q{number}" for number in range(1, QUESTIONS + 1)] == re.findall(r'id="(q\d+)"', text)
    assert FETCHED.findall(text) == []


@pytest.mark.parametrize("missing", LINES)
def test_a_link_that_leads_nowhere_fails_the_build(tmp_path: Path, missing: str) -> None:
    page = tmp_path / "from" / PAGES / "index.md"
    page.parent.mkdir(parents=True)
    page.write_text(f"# One\n\n{LINES[missing]}\n", "utf-8")
    assert built(tmp_path / "site", tmp_path / "from").returncode == 1


@pytest.mark.skipif(sys.platform != "linux", reason="its blocks are of a shell")
@pytest.mark.parametrize("page", ["footstep", "tapping", "presented", "coming"])
def test_every_block_of_a_tutorial_runs_as_pasted(tmp_path: Path, page: str) -> None:
    """Nobody types in a practice, so it pauses."""
    text = (REPOSITORY / PAGES / f"{page}.md").read_text("utf-8")
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    for block in re.findall(r"^```sh\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        command = ["bash", "-euo", "pipefail", "-c", block]
        done = subprocess.run(
            command,
            cwd=tmp_path,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, block + done.stdout + done.stderr
