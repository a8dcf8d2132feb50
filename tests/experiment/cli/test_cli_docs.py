"""`palpate docs`, and what a shell is told when somebody presses Tab."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from palpate.experiment import __main__
from palpate.experiment.cli import COMMANDS, docs, options
from palpate.experiment.protocol import files
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


def test_every_guide_of_protocols_and_devices_is_listed(repository_root: Path) -> None:
    guides = {file for file, _ in docs.GUIDES.values()}
    rooms = [repository_root / room for room in ("protocols", "experiment/apparatus")]
    assert {path.relative_to(repository_root).as_posix() for room in rooms for path in room.rglob("*.md")} <= guides


def test_a_path_of_the_guides_is_the_shipped_file_where_there_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As after the install of a wheel, which has no folder `protocols`."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(files, "PACKAGE", tmp_path / "package")
    inside = tmp_path / "package" / "shipped" / "rigs" / "one.toml"
    inside.parent.mkdir(parents=True)
    inside.touch()
    own = Path("protocols/rigs/one.toml")
    given = [str(own), "protocols/mine.toml", "rigs/one.toml"]
    assert [*map(options.a_file, given)] == [inside, *map(Path, given[1:])]
    own.parent.mkdir(parents=True)
    own.touch()
    assert options.a_file(str(own)) == own
