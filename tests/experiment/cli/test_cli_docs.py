"""`palpate docs`, and what a shell is told when somebody presses Tab."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from palpate.experiment import __main__
from palpate.experiment.cli import COMMANDS, docs
from tests.conftest import Palpate


def test_the_list_names_every_guide_and_its_file(palpate: Palpate, repository_root: Path) -> None:
    code, out, _ = palpate("docs", "--path")
    assert code == 0
    listed = dict(line.split(maxsplit=1) for line in out.splitlines())
    assert listed == {name: str(repository_root / file) for name, (file, _) in docs.GUIDES.items()}
    _, out, _ = palpate("docs")
    assert [line.split()[0] for line in out.splitlines()[1:]] == [*docs.GUIDES]


def test_a_guide_goes_into_a_pipe_as_it_is(palpate: Palpate, repository_root: Path) -> None:
    code, out, _ = palpate("docs", "firmware")
    assert (code, out.rstrip()) == (0, (repository_root / docs.GUIDES["firmware"][0]).read_text("utf-8").rstrip())


def test_another_name_is_refused_with_all_of_them(palpate: Palpate) -> None:
    code, _, err = palpate("docs", "nothing")
    assert code == 2
    assert all(name in err for name in docs.GUIDES)


def completed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], **typed: str) -> str:
    """Return what the command replies to a shell, which calls it without a word: that alone prints the overview."""
    for name, value in typed.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("sys.argv", ["palpate"])
    # The variable has the name of the program, which is that of the tests otherwise.
    monkeypatch.setattr(sys.modules["__main__"], "__package__", None)
    with pytest.raises(SystemExit):
        __main__.main()
    return capsys.readouterr().out


def test_tab_completes_commands(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    typed = {"_PALPATE_COMPLETE": "complete_bash", "COMP_WORDS": "palpate a", "COMP_CWORD": "1"}
    names = {name for part in COMMANDS.values() for name in part if name.startswith("a")}
    assert set(completed(monkeypatch, capsys, **typed).split()) == names


@pytest.mark.skipif(sys.platform != "linux", reason="needs bash")
def test_bash_can_read_its_completion(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    script = completed(monkeypatch, capsys, _PALPATE_COMPLETE="source_bash")
    assert "complete_bash" in script
    assert subprocess.run(["bash", "-n"], input=script, text=True, check=False).returncode == 0
