"""The report in a real browser: it renders, it fetches nothing, and its console stays empty."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from analysis.analyse import analyse

BROWSERS = ("chromium", "chromium-browser", "google-chrome")


@pytest.fixture(scope="module")
def report(repository_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return analyse([repository_root / "participants" / "okamoto2012"], tmp_path_factory.mktemp("report")).report


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


@pytest.mark.parametrize("width", [1280, 500])
def test_the_page_is_no_wider_than_its_window(report: Path, browse: list[str], tmp_path: Path, width: int) -> None:
    probe = "<script>document.title = document.documentElement.scrollWidth + ' of ' + window.innerWidth</script></body>"
    measured = tmp_path / "measured.html"
    measured.write_text(report.read_text("utf-8").replace("</body>", probe), "utf-8")
    shown = [f"--window-size={width},2000", "--hide-scrollbars", "--dump-dom", measured.as_uri()]
    done = subprocess.run([*browse, *shown], capture_output=True, text=True, timeout=120, check=True)
    wide, window = map(int, done.stdout.partition("<title>")[2].partition("</title>")[0].split(" of "))
    assert window == width
    assert wide <= window


def test_it_names_nothing_outside_itself(report: Path) -> None:
    text = report.read_text("utf-8")
    for outside in ("<script", "<link", 'src="http', "@import", "url(http"):
        assert outside not in text
