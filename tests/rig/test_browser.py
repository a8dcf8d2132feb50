"""The report in a real browser: it renders, it fetches nothing, and its console stays empty."""

from __future__ import annotations

import re
import shutil
import subprocess
from datetime import date
from pathlib import Path

import pytest

from palpate.analysis.analyse import analyse
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.page import html
from tests.analysis.datasets import balanced, write_dataset
from tests.experiment.protocol.small import changed, document
from tests.experiment.protocol.test_html import HOSTILE

BROWSERS = ("chromium", "chromium-browser", "google-chrome")


@pytest.fixture(scope="module")
def report(repository_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return analyse([repository_root / "participants" / "okamoto2012"], tmp_path_factory.mktemp("report")).report


@pytest.fixture(scope="module")
def of_six(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report whose first figure, of six materials, is wider than half of a page."""
    names = ("copy paper", "aluminum foil", "polypropylene", "typing paper", "felt", "cork")
    sessions = {str(k): {task: balanced(k, materials=names) for task in ("virtual", "real")} for k in range(6)}
    root = write_dataset(tmp_path_factory.mktemp("six") / "made", sessions, materials=names, origin="REHEARSAL")
    return analyse([root], root.parent / "report").report


@pytest.fixture
def browse(tmp_path: Path) -> list[str]:
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip("needs headless Chromium")
    quiet = ["--disable-gpu", "--disable-quic", "--disable-sync", "--no-first-run", "--disable-component-update"]
    offline = ["--disable-background-networking", "--host-resolver-rules=MAP * ~NOTFOUND"]
    return [browser, "--headless", "--no-sandbox", f"--user-data-dir={tmp_path / 'profile'}", *quiet, *offline]


def test_it_renders_and_its_console_stays_empty(report: Path, browse: list[str]) -> None:
    done = subprocess.run(
        [*browse, "--enable-logging=stderr", "--dump-dom", report.as_uri()],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert "RECONSTRUCTION" in done.stdout
    assert done.stdout.count("<svg") >= 2
    assert [line for line in done.stderr.splitlines() if "CONSOLE" in line] == []


def test_a_hostile_protocol_becomes_a_page_that_runs_nothing_and_prints(tmp_path: Path, browse: list[str]) -> None:
    study = ProtocolFile.model_validate(changed(document(), ("consent", "statement"), HOSTILE))
    page = tmp_path / "board.html"
    page.write_text(html(study, "small.toml", "NOT SEALED: none.", None, date(2020, 6, 1)), "utf-8")
    done = subprocess.run(
        [*browse, "--enable-logging=stderr", "--dump-dom", page.as_uri()],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert "<title>Protocol of the study small</title>" in done.stdout
    assert "<script" not in done.stdout
    assert [line for line in done.stderr.splitlines() if "CONSOLE" in line] == []
    printed = tmp_path / "board.pdf"
    subprocess.run(
        [*browse, "--no-pdf-header-footer", f"--print-to-pdf={printed}", page.as_uri()],
        capture_output=True,
        timeout=120,
        check=True,
    )
    # A4 is 595 by 842 points.
    box = re.search(rb"/MediaBox \[0 0 (\d+)\S* (\d+)", printed.read_bytes())
    assert box is not None
    assert [float(side) for side in box.groups()] == pytest.approx([595, 842], abs=1)


PROBE = """<!DOCTYPE html><html><body style="margin:0"><iframe src="%s" style="width:%dpx;height:2000px;border:0">
</iframe><script>
const frame = document.querySelector("iframe");
frame.onload = () => {
  const page = frame.contentDocument, wide = frame.contentWindow.innerWidth, found = [];
  const say = (what, one) => found.push(what + ": " + one.tagName + " " + one.textContent.trim().slice(0, 40));
  if (page.documentElement.scrollWidth > wide) say("the page scrolls sideways", page.body);
  const blocks = [...page.querySelectorAll("h1, h2, h3, p, nav, li, dt, dd, figure, figcaption, .scroll, .scroll svg")];
  for (const one of blocks) {
    const box = one.getBoundingClientRect();
    if (box.right > wide + 0.5 || box.left < -0.5) say("beyond the edge", one);
    if (box.width < 1 || box.height < 1) say("without size", one);
  }
  for (const one of page.querySelectorAll("th, td, p, dd, figcaption"))
    if (one.scrollWidth > one.clientWidth + 1) say("runs over its box", one);
  const answers = [...page.querySelectorAll(".first .asked dd")];
  const told = answers.at(wide > 1000 ? -1 : 0).getBoundingClientRect();
  if (told.bottom > 800) say("an answer lies below the first screen", page.body);
  for (const parent of page.querySelectorAll("main, section, .figures, figure, dl, nav ul")) {
    const boxes = [...parent.children].map(one => [one, one.getBoundingClientRect()]);
    for (const [i, [one, a]] of boxes.entries()) for (const [other, b] of boxes.slice(i + 1))
      if (Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1 && Math.min(a.bottom, b.bottom) -
          Math.max(a.top, b.top) > 1) say("over " + other.tagName, one);
  }
  const first = page.querySelector(".first figure .scroll");
  if (wide > 1000 && first.scrollWidth > first.clientWidth + 1) say("the first figure is cut", first);
  document.title = wide + " wide, " + blocks.length + " blocks;" + found.join("|") + ";";
};
</script></body></html>"""


@pytest.mark.parametrize(("made", "width"), [("report", 1280), ("report", 400), ("of_six", 1280)])
def test_nothing_runs_over_or_beyond_the_window(
    browse: list[str], tmp_path: Path, request: pytest.FixtureRequest, made: str, width: int
) -> None:
    """In a frame as wide as the window should be, for headless Chromium opens no window below 500 px."""
    probe = tmp_path / "probe.html"
    probe.write_text(PROBE % (request.getfixturevalue(made).as_uri(), width), "utf-8")
    shown = ["--allow-file-access-from-files", "--window-size=1300,2000", "--dump-dom", probe.as_uri()]
    done = subprocess.run([*browse, *shown], capture_output=True, text=True, timeout=120, check=True)
    size, found = done.stdout.partition("<title>")[2].partition("</title>")[0].split(";")[:2]
    assert size.startswith(f"{width} wide")
    assert int(size.split()[2]) > 100
    assert found.split("|") == [""]


def test_it_names_nothing_outside_itself(report: Path) -> None:
    text = report.read_text("utf-8")
    for outside in ("<script", "<link", 'src="http', "@import", "url(http"):
        assert outside not in text
