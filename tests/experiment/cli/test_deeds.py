"""What the desk offers at each point of a study, why it does not offer the rest, and what it does."""

from __future__ import annotations

import asyncio
import re
import signal
import sys
from collections.abc import Callable, Iterator
from datetime import date, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import TextIO

import pytest

from palpate.experiment import __main__, cli, storage
from palpate.experiment.cli.desk import deeds, home, study
from palpate.experiment.cli.desk.place import Place
from palpate.experiment.cli.desk.study import Practice
from palpate.experiment.desk.console.home import Chosen, HomePage, Scene
from palpate.experiment.errors import PalpateError
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.approval import sealing
from palpate.experiment.protocol.new import NewStudy
from palpate.experiment.protocol.new import text as new_protocol
from palpate.experiment.records import journal
from palpate.experiment.records.progress import progress
from palpate.experiment.rehearsal.kinds.footstep import participant
from palpate.experiment.rehearsal.shorter import shortened
from palpate.experiment.rehearsal.study import PRACTICE_SEED, practice_folder
from palpate.experiment.study import enrolment, roster
from palpate.experiment.study.people import enrolling
from palpate.experiment.study.schedule import allocate
from tests.conftest import Palpate
from tests.experiment.protocol.small import SMALL
from tests.rig.laboratory import HURRIED, write_rig

TODAY = date.today()


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("EDITOR", "an-editor")
    monkeypatch.setattr("shutil.which", lambda name: name)
    return tmp_path


@pytest.fixture
def small(folder: Path) -> Path:
    """A study whose tasks are of real objects, which needs no recordings."""
    file = folder / "small.toml"
    days = SMALL.replace("2020-02-01", str(TODAY - timedelta(30))).replace("2021-02-01", str(TODAY + timedelta(30)))
    file.write_text(days.replace('stimulus = "virtual"', 'stimulus = "real"'), "utf-8")
    return file.relative_to(folder)


def seal(file: Path, *, replace: bool = False) -> None:
    protocol = files.load(file)
    sealing.write(
        file,
        protocol,
        approval_number="7",
        board=protocol.ethics.board,
        approved_on=TODAY - timedelta(30),
        expires_on=TODAY + timedelta(30),
        replace=replace,
    )


def possible(scene: Scene) -> set[str]:
    return {one.name for one in scene.deeds if not one.refuses}


def first(scene: Scene) -> dict[str, str]:
    return {one.name: one.first for one in scene.deeds if one.first}


def test_in_an_empty_folder_a_protocol_comes_first() -> None:
    scene = deeds.scene(Place.here())
    assert possible(scene) == {"new"}
    assert {*first(scene).values()} == {"new"}
    assert scene.next == "new"


def test_a_protocol_with_errors_is_edited_or_checked(folder: Path) -> None:
    (folder / "broken.toml").write_text("[study]\nid = 3\n", "utf-8")
    scene = deeds.scene(Place.here())
    assert possible(scene) == {"new", "edit", "check"}
    assert scene.next == "edit"
    assert scene.deed("edit").command == ("an-editor", "broken.toml")
    assert len(scene.deed("seal").refuses) > 1


def test_a_new_protocol_is_practiced_and_filled_in_before_anybody_is_enrolled(folder: Path, palpate: Palpate) -> None:
    (folder / "mystudy.toml").write_text(new_protocol(NewStudy()), "utf-8")
    scene = deeds.scene(Place.here())
    assert possible(scene) == {"new", "edit", "check", "rig", "pilot", "practice"}
    assert {name: first(scene)[name] for name in ("seal", "enrol", "begin")} == dict.fromkeys(
        ("seal", "enrol", "begin"), "edit"
    )
    assert len(scene.deed("begin").refuses) == 3
    assert scene.next == "practice"
    # The command refuses as well, and burns no dataset's name.
    assert palpate("enrol", "mystudy.toml", "-p", "01")[0] == 2
    assert [*folder.iterdir()] == [folder / "mystudy.toml"]


def test_a_study_goes_from_its_seal_to_its_first_session(folder: Path, small: Path, palpate: Palpate) -> None:
    seal(small)
    scene = deeds.scene(Place.here())
    assert scene.next == "practice"
    assert {"enrol", "rig"} <= possible(scene)
    assert scene.deed("seal").refuses
    assert first(scene)["begin"] == "rig"
    assert first(scene)["consent"] == "enrol"
    write_rig(folder, "rehearsal", port='"/dev/none"', address='"127.0.0.1:7402"')
    place = Place.here()
    assert place.rig == Path("rig.toml")
    scene = deeds.scene(place)
    assert {"doctor"} <= possible(scene)
    assert first(scene)["begin"] == "enrol"
    _, *enrol = scene.deed("enrol").line(("01", str(TODAY)))
    assert palpate(*enrol)[0] == 0
    scene = deeds.scene(place)
    assert {"begin", "withdraw", "status"} <= possible(scene)
    assert scene.deed("enrol").fields[0].text == "02"
    assert scene.deed("begin").line(("01",))[:6] == (
        "palpate",
        "run",
        "small.toml",
        "--rig",
        "rig.toml",
        "--participant",
    )
    # A rig that `palpate run` refuses is refused here.
    assert "simulated" in deeds.scene(Place(small, files.shipped("rigs/rehearsal.toml"))).deed("begin").refuses[0].what
    _, *withdraw = scene.deed("withdraw").line(("01", "asked to stop", "no"))
    assert palpate(*withdraw)[0] == 0
    assert first(deeds.scene(place))["begin"] == "enrol"


def test_who_has_not_consented_is_asked_for(small: Path) -> None:
    seal(small)
    enrolling.enrol(small, "01", None, root=None, seed=1)
    deed = deeds.scene(Place.here()).deed("consent")
    assert [one.text for one in deed.fields] == ["01", str(TODAY)]


def test_a_dataset_follows_its_protocol_until_somebody_consents(small: Path) -> None:
    enrolling.enrol(small, "01", None, root=None, seed=1)
    root = Path("participants/small")
    small.write_text(small.read_text("utf-8").replace("A small study", "A smaller study"), "utf-8")
    seal(small)
    enrolling.enrol(small, "02", TODAY, root=None, seed=1)
    assert files.load(storage.protocol_path(root)).study.title == "A smaller study"
    assert approval.read(storage.protocol_path(root)).protocol_sha256 == approval.sha256(files.load(small))
    assert [*roster.Roster.load(storage.roster_path(root)).consent_on] == ["01", "02"]
    small.write_text(small.read_text("utf-8").replace("A smaller study", "Another study"), "utf-8")
    seal(small, replace=True)
    assert "different version" in deeds.scene(Place.here()).deed("enrol").refuses[0].what
    assert files.load(storage.protocol_path(root)).study.title == "A smaller study"


def everything(root: Path) -> dict[Path, bytes]:
    return {one: one.read_bytes() for one in root.rglob("*") if one.is_file()}


def test_what_only_looks_or_is_refused_writes_nothing(folder: Path, small: Path, palpate: Palpate) -> None:
    text = small.read_text("utf-8")
    small.write_text(text.replace("required = true", "required = false"), "utf-8")
    seal(small)
    rig = write_rig(folder, "rehearsal", port='"/dev/none"', address='"127.0.0.1:7402"')
    enrolling.enrol(small, "01", None, root=None, seed=1)
    root = Path("participants/small")
    before = everything(root)
    draft = Path("draft.toml")
    draft.write_text(small.read_text("utf-8").replace("A small study", "A draft"), "utf-8")
    seal(draft)
    assert {"enrol", "begin"} <= possible(deeds.scene(Place(draft, rig)))
    assert palpate("schedule", draft, "-p", "01")[0] == 0
    tomorrow = TODAY + timedelta(1)
    for refused in (
        ("enrol", draft, "-p", "01"),
        ("enrol", draft, "-p", "02", "--seed", 2),
        ("enrol", draft, "-p", "02", "--consent-on", tomorrow),
        ("consent", draft, "-p", "01", "--consent-on", tomorrow),
        ("consent", draft, "-p", "02", "--consent-on", TODAY),
    ):
        assert palpate(*refused)[0] == 2
    assert everything(root) == before
    assert palpate("consent", draft, "-p", "01", "--consent-on", TODAY)[0] == 0
    assert files.load(storage.protocol_path(root)).study.title == "A draft"


def practiced(file: Path, repetitions: int | None, *tasks: str, version: str = "") -> Path:
    """Have the first participant's tasks practiced, or one begun of another version of the protocol."""
    folder = practice_folder(file, repetitions)
    plan = storage.plan_path(folder)
    plan.parent.mkdir(parents=True, exist_ok=True)
    with shortened(file, repetitions) as short:
        storage.write_json(plan, {"protocol_sha256": version or approval.sha256(files.load(short))})
    for task in tasks:
        path = storage.journal_path(folder, "01", task)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"\n")
    return folder


@pytest.mark.parametrize("repetitions", [None, 1, 2])
def test_practice_of_an_older_version_is_left_where_it_is(small: Path, repetitions: int | None) -> None:
    old = practiced(small, repetitions, version="of another version")
    assert practice_folder(small, repetitions) == old.with_name(f"{old.name}-2")
    assert practiced(small, repetitions) == practiced(small, repetitions) == old.with_name(f"{old.name}-2")


def test_the_first_practice_is_short_and_the_next_whole(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, short = Practice(small, None), Practice(small, 1)
    trials = {task.id: (short.trials(task.id), whole.trials(task.id)) for task in files.load(small).tasks}
    assert trials == {"one": (2, 6), "two": (2, 4)}
    complete: set[Path] = set()

    def begun(path: Path) -> SimpleNamespace:
        return SimpleNamespace(entries=[path] if path in complete else [])

    monkeypatch.setattr(study, "progress", lambda _: SimpleNamespace(complete=True))
    monkeypatch.setattr("palpate.experiment.cli.desk.study.journal.read_if_begun", begun)

    def proposed() -> tuple[str, ...]:
        return tuple(field.text for field in deeds.scene(Place.here()).deed("practice").fields)

    first, second = allocate(files.load(small), PRACTICE_SEED)[0].tasks
    assert proposed() == ("1", first, "01")
    few, many = trials[first]
    assert f"{few} of {many} trials" in deeds.scene(Place.here()).deed("practice").does
    for task, then in ((first, ("1", second, "01")), (second, ("", first, "01"))):
        complete.add(storage.journal_path(practiced(small, 1, task), "01", task))
        assert proposed() == then
    complete.clear()
    assert deeds.scene(Place.here()).deed("analyse").command[-1] == str(practice_folder(small, 1))
    assert proposed()[0] == "1"
    practiced(small, None, first)
    # What is under way is continued.
    assert proposed() == ("", first, "01")
    with pytest.raises(PalpateError):
        deeds.scene(Place.here()).deed("practice").line(("0", "", "01"))
    line = deeds.scene(Place.here()).deed("practice").line(("2", "", "01"))
    assert line[2:] == ("small.toml", "--practice", "--repetitions", "2", "--participant", "01")


def test_a_pilot_is_enrolled_apart_and_the_desk_goes_back(small: Path, palpate: Palpate) -> None:
    seal(small)
    place, _ = home.carry_out(Place.here(), Chosen("pilot", deeds.scene(Place.here()).deed("pilot").command))
    scene = deeds.scene(place)
    root = Path("participants/small-pilot")
    assert (place.dataset, scene.facts[2][0]) == (root, "Pilot")
    for label in ("01", "02"):
        _, *enrol = deeds.scene(place).deed("enrol").line((label, str(TODAY)))
        assert palpate(*enrol)[0] == 0
    assert enrolment.purpose_of(root) == "PILOT"
    back, _ = home.carry_out(place, Chosen("pilot", deeds.scene(place).deed("pilot").command))
    assert back == Place.here()
    assert deeds.scene(back).deed("enrol").fields[0].text == "01"
    # Another dataset that was named has no pilot.
    assert deeds.scene(Place(small, dataset=Path("elsewhere"))).deed("pilot").refuses


def test_what_the_board_decides_and_is_told_goes_on_record(
    small: Path, palpate: Palpate, monkeypatch: pytest.MonkeyPatch
) -> None:
    seal(small)
    assert not {"amend", "suspend", "incident", "facts"} & possible(deeds.scene(Place.here()))
    enrolling.enrol(small, "01", TODAY, root=None, seed=1)
    scene = deeds.scene(Place.here())
    # The seal is that of the dataset, so that there is nothing to amend.
    assert scene.deed("amend").refuses
    assert {"suspend", "incident"} <= possible(scene)
    _, *incident = scene.deed("incident").line(("a fall", "", "the session was ended", str(TODAY), "", "", "", "no"))
    assert palpate(*incident)[0] == 0
    _, *wrong = scene.deed("incident").line(("", "a label", "it is told", str(TODAY), "", "01", "real=02", "yes"))
    assert wrong[-5:] == ["--participant", "01", "--took-part", "real=02", "--exchanged"]
    small.write_text(small.read_text("utf-8").replace("A small study", "A smaller study"), "utf-8")
    assert first(deeds.scene(Place.here()))["amend"] == "seal"
    seal(small, replace=True)
    deed = deeds.scene(Place.here()).deed("amend")
    with pytest.raises(PalpateError):
        deed.line(("sometimes", "nobody", ""))
    monkeypatch.setattr("builtins.input", lambda *_: "amend")
    _, *amend = deed.line(("session", "nobody", ""))
    assert palpate(*amend, "--yes")[0] == 0
    root = Path("participants/small")
    known = roster.Roster.load(storage.roster_path(root))
    assert ([one.number for one in known.approved], len(known.incidents)) == ([2], 1)
    _, *suspend = deeds.scene(Place.here()).deed("suspend").line((str(TODAY), "", "", "a fall"))
    assert palpate(*suspend)[0] == 0
    assert deeds.scene(Place.here()).deed("enrol").refuses


def test_a_protocol_that_asks_has_its_facts_recorded(small: Path, palpate: Palpate) -> None:
    asked = '[[asked.people]]\nid = "age"\nquestion = "How old are you?"\nanswer = "number"\nleast = 18\nmost = 89\n'
    text = re.sub(r"(?m)^format = \d+", "format = 7", small.read_text("utf-8"))
    small.write_text(f'{text}\n{asked}reason = "Skin ages."\n', "utf-8")
    seal(small)
    enrolling.enrol(small, "01", TODAY, root=None, seed=1)
    _, *facts = deeds.scene(Place.here()).deed("facts").line(("01", "age=34"))
    assert palpate(*facts)[0] == 0


def test_calibrating_writes_a_rig_file_of_another_name(folder: Path, small: Path) -> None:
    assert first(deeds.scene(Place.here()))["calibrate"] == "rig"
    write_rig(folder, "rehearsal", port='"/dev/none"', address='"127.0.0.1:7402"')
    (folder / "rig-2.toml").touch()
    deed = deeds.scene(Place.here()).deed("calibrate")
    typed = [one.text for one in deed.fields]
    assert typed == ["tracker", "rig.toml", "rig-3.toml"]
    line = ("palpate", "calibrate", "tracker", "--rig", "rig.toml", "--out", "rig-3.toml")
    assert deed.line(tuple(typed)) == line
    with pytest.raises(PalpateError):
        deed.line(("pedal", *typed[1:]))


def test_another_study_of_the_folder_is_opened(small: Path) -> None:
    assert deeds.scene(Place.here()).deed("open").refuses
    other = small.with_name("other.toml")
    other.write_text(small.read_text("utf-8"), "utf-8")
    deed = deeds.scene(Place(small)).deed("open")
    place, _ = home.carry_out(Place(small, dataset=Path("x")), Chosen("open", deed.line((deed.fields[0].text,))))
    assert place == Place(other)
    with pytest.raises(PalpateError):
        deed.line(("missing.toml",))


def test_ctrl_c_where_enter_is_asked_for_goes_back_to_the_desk(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr("sys.stdin", SimpleNamespace(readline=interrupted, fileno=lambda: 0))
    home._wait()


def test_a_rig_is_chosen_or_written(folder: Path, small: Path) -> None:
    place, said = home.carry_out(Place(small), Chosen("rig", ("rig", "our.toml", "takes")))
    assert (place.rig, place.recordings, "Written" in said) == (Path("our.toml"), Path("takes"), True)
    again, _ = home.carry_out(place, Chosen("rig", ("rig", "our.toml")))
    assert (again.rig, again.recordings) == (Path("our.toml"), None)
    refused, said = home.carry_out(place, Chosen("rig", ("rig", "our.txt")))
    assert (refused, "our.txt" in said) == (place, True)


def test_palpate_alone_is_the_desk_at_a_terminal_with_a_study_or_in_an_empty_folder(
    small: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    began: list[list[str]] = []
    monkeypatch.setattr("palpate.experiment.cli.app.main", lambda: began.append([*__import__("sys").argv]))

    def alone(*, terminal: bool) -> str:
        for name in ("stdin", "stdout", "stderr"):
            monkeypatch.setattr(f"sys.{name}.isatty", lambda: terminal, raising=False)
        monkeypatch.setattr("sys.argv", ["palpate"])
        __main__.main()
        return capsys.readouterr().out

    assert alone(terminal=False).startswith("Usage")
    assert alone(terminal=True) == ""
    assert began == [["palpate", "desk"]]
    small.unlink()
    assert alone(terminal=True) == ""
    Path("of-another-trade.txt").touch()
    assert alone(terminal=True).startswith("Usage")


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="Windows sends no Ctrl-C to one process")
def test_ctrl_c_is_for_the_command_that_runs_and_the_desk_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(home, "_wait", lambda: None)
    before = signal.getsignal(signal.SIGINT)
    pressed = """
import os, signal, sys, time
os.kill(os.getppid(), signal.SIGINT)
time.sleep(0.1)
sys.exit(7 if signal.getsignal(signal.SIGINT) is signal.default_int_handler else 8)
"""
    assert home._run((sys.executable, "-S", "-c", pressed)) == 7
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("named", ["it's", "is-not-installed --wait"])
def test_an_editor_that_cannot_be_started_is_named(small: Path, monkeypatch: pytest.MonkeyPatch, named: str) -> None:
    monkeypatch.setattr("shutil.which", lambda _: None)
    monkeypatch.setenv("EDITOR", named)
    assert named in deeds.scene(Place(small)).deed("edit").refuses[0].what


def test_a_file_that_cannot_be_read_is_no_study_of_this_folder(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("other.toml").touch()

    def opened(name: str, encoding: str, errors: str) -> TextIO:
        if name == "other.toml":
            raise PermissionError(13, "Permission denied", name)
        return Path(name).open(encoding=encoding, errors=errors)

    monkeypatch.setattr(cli, "open", opened, raising=False)
    assert cli.files_with("study") == [small.name]


@pytest.fixture
def at_desk(palpate: Palpate, monkeypatch: pytest.MonkeyPatch) -> Callable[[Iterator[tuple[str, ...]]], list[str]]:
    """Have keys pressed at each page of a desk; commands run in this process, and simulated people hurry."""
    said: list[str] = []
    vars_of = vars(participant)
    for name, value in HURRIED.items():
        monkeypatch.setitem(vars_of, name, value)

    def run(command: list[str], **_: object) -> SimpleNamespace:
        code, out, err = palpate(*command[command.index("palpate.experiment") + 1 :])
        said.append(out + err)
        return SimpleNamespace(returncode=code, stdout=out.encode())

    def at(pages: Iterator[tuple[str, ...]]) -> list[str]:
        async def act(app: HomePage) -> Chosen | None:
            async with app.run_test(size=(80, 24)) as pilot, asyncio.timeout(20):
                while app._scene is None:
                    await pilot.pause()
                await pilot.press(*next(pages))
            return app.return_value

        monkeypatch.setattr(home, "subprocess", SimpleNamespace(run=run, PIPE=None))
        monkeypatch.setattr(home, "_wait", lambda: None)
        monkeypatch.setattr(HomePage, "run", lambda app: asyncio.run(act(app)))
        home.stay(Place(session=("--by", "console", "--lines")))
        return said

    return at


def test_from_an_empty_folder_to_a_practiced_session_in_the_desk_alone(
    at_desk: Callable[[Iterator[tuple[str, ...]]], list[str]],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    heard = re.compile(r"participant 01 says: (.*)\.|says: (.*)\.\n")
    shown = ""

    def typed(asked: str = "") -> str:
        """Answer the questions of `palpate new`, and key what the participant says."""
        nonlocal shown
        shown += capsys.readouterr().out + asked
        if "Tasks: virtual" in asked:
            return "virtual"
        if (again := re.search(r"type (\S) again", asked)) is not None:
            return again[1]
        if "[y]" in asked:
            return "y"
        said = next(iter(heard.findall(shown)[-1:]), None) if "participant say" in asked else None
        return max(said)[0] if said else ""

    monkeypatch.setattr("builtins.input", typed)
    said = at_desk(iter([("enter",), ("enter", "enter"), ("f9",)]))
    short = Path("participants/practice-mystudy-1-of-each")
    entries = journal.read(storage.journal_path(short, "01", "virtual")).entries
    assert progress(entries).complete
    assert len(said) == 2
