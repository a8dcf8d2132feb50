"""Questionnaires before and after a task: each answer on disk, asked once though killed, and a table for others."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import signal
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import pytest

from palpate.analysis.analyse import analyse
from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.dataset import build, checks, phenotype
from palpate.experiment.dataset.outside import sharing
from palpate.experiment.dataset.verify import verify
from palpate.experiment.desk.questions import Reply, Report
from palpate.experiment.errors import PauseAsked, RosterError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal, transcript
from palpate.experiment.records.entries import Answer, Footer, Phase, Questioned
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.study import withdrawal
from palpate.experiment.study.people import enrolling
from tests.experiment.dataset.outside.test_sharing import licensed
from tests.experiment.dataset.studies import MadeStudy, framed, make_study
from tests.experiment.protocol.asking import FORMS, SHARING, TOUCH, asking
from tests.experiment.session.bench import Bench
from tests.experiment.session.scripted import (
    START_NS,
    ScriptedActuator,
    ScriptedConsole,
    ScriptedTracker,
    step_samples,
)

ALLOWED = SHARING.replace('facts = ["age", "sex"]', 'questionnaires = ["before", "afterwards"]')

RIG = shipped("rigs/rehearsal.toml")


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("questionnaires") / "study"
    return make_study(place, sessions=0, enrolled=3, further=asking(ALLOWED, FORMS)).file.parent


@pytest.fixture
def study(begun: Path, tmp_path: Path) -> MadeStudy:
    folder = shutil.copytree(begun, tmp_path / "study")
    return MadeStudy(folder / "study.toml", folder / "dataset")


def run(
    study: MadeStudy,
    typed: Iterable[str],
    keys: str = "capt",
    participant: str = "01",
    rig_file: Path = RIG,
) -> list[str]:
    """Run a task with questionnaires, or the rest; return what is left to type; `|` pauses there, `!` kills."""
    left, clock = deque(typed), ManualClock(START_NS)

    def write() -> Reply:
        if (text := left.popleft() if left else "") == "|":
            raise PauseAsked("by the experimenter")
        if text == "!":
            os.kill(os.getpid(), signal.SIGKILL)
        return Reply(text=text)

    console = ScriptedConsole(clock, keys)
    console.instead[Report] = write
    steps = [framed(step_samples(600_000 * n, 100.0 * n)) for n in range(1, len(keys) + 1)]
    devices = ScriptedTracker(steps, clock=clock), console, ScriptedActuator()
    header = study.header(participant, "virtual").model_copy(update={"rig_sha256": rigs.sha256(rigs.load(rig_file))})
    Bench(*devices, clock, [], rig_file=rig_file).run(study.protocol, header, study.root)
    return [*left]


def answers(study: MadeStudy, participant: str = "01") -> dict[str, object]:
    entries = journal.read(storage.journal_path(study.root, participant, "virtual")).entries
    return {one.step: one.answer for one in entries if isinstance(one, Questioned)}


def test_items_are_asked_in_order_before_and_after_until_the_answer_is_allowed(study: MadeStudy) -> None:
    assert run(study, ["8", "tired", "3", "sandals", "-1", "12,5", "like sand"]) == []
    assert answers(study) == {
        "before.tired": 3,
        "before.shoes": "sandals",
        "afterwards.minutes": 12.5,
        "afterwards.words": "like sand",
    }
    path = storage.journal_path(study.root, "01", "virtual")
    kinds = [type(entry) for entry in journal.read(path).entries]
    places = [place for place, kind in enumerate(kinds) if kind is Questioned]
    assert places[1] < kinds.index(Phase)
    assert len(kinds) - 1 - kinds[::-1].index(Answer) < places[2]
    assert transcript.text(journal.read(path), None).count("afterwards.words") == 1


@pytest.mark.parametrize("at", [0, 1, 2, 3])
def test_a_pause_at_any_item_asks_that_one_again_and_none_twice(study: MadeStudy, at: int) -> None:
    typed = ["3", "2", "10", "fine"]
    run(study, [*typed[:at], "|"])
    assert len(answers(study)) == at
    assert run(study, typed[at:], keys="capt" if at < 2 else "") == []
    assert list(answers(study).values()) == [3, "sandals", 10, "fine"]
    last = journal.read(storage.journal_path(study.root, "01", "virtual")).entries[-1]
    assert isinstance(last, Footer)
    assert last.reason == "complete"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("at", [0, 1, 2, 3])
def test_a_kill_at_any_item_costs_that_one_alone(study: MadeStudy, at: int) -> None:
    typed = ["3", "2", "10", "fine"]
    if (child := os.fork()) == 0:
        run(study, [*typed[:at], "!"])
        os._exit(1)
    assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL
    assert len(answers(study)) == at
    assert run(study, typed[at:], keys="capt" if at < 2 else "") == []
    assert list(answers(study).values()) == [3, "sandals", 10, "fine"]


def test_the_table_has_units_and_levels_and_is_remade_as_the_journals_say(study: MadeStudy) -> None:
    run(study, ["3", "", "10", ""])
    build.build(study.root)
    folder = study.root / "phenotype"
    assert checks.table_rows(folder / "before.tsv")[:-1] == [
        {"participant_id": "sub-01", "tired": "3", "shoes": "n/a"},
    ]
    described = json.loads((folder / "afterwards.json").read_text("utf-8"))
    assert described["minutes"]["Units"] == "min"
    assert verify(study.root).refused == 0
    table = folder / "before.tsv"
    table.write_bytes(table.read_bytes().replace(b"\t3\t", b"\t4\t"))
    assert verify(study.root).refused == 1
    table.unlink()
    assert verify(study.root).refused == 1


def test_erasure_leaves_no_answer(study: MadeStudy) -> None:
    run(study, ["3", "shoes", "10", "bog snorkelling"])
    build.build(study.root)
    withdrawal.withdraw(study.file, "01", "asked to stop", root=study.root, rebuild=build.build, erase=True)
    left = [path for path in study.root.rglob("*") if path.is_file() and b"snorkelling" in path.read_bytes()]
    assert left == []
    assert verify(study.root).refused == 0


def test_a_copy_for_others_has_the_tables_without_texts(study: MadeStudy, tmp_path: Path) -> None:
    run(study, ["3", "shoes", "10", "bog snorkelling"])
    run(study, ["5", "3", "11", ""], participant="03")
    build.build(study.root)
    licensed(study)
    for label in ("01", "03"):
        enrolling.sharing(study.file, label, True, root=study.root)
    out = sharing.share(study.root, tmp_path / "copy").root
    rows = checks.table_rows(out / "phenotype" / "afterwards.tsv")[:-1]
    assert sorted(row.pop("minutes") for row in rows) == ["10", "11"]
    assert [set(row) for row in rows] == [{"participant_id"}] * 2
    assert {row["participant_id"] for row in rows} == {path.name for path in out.glob("sub-*")}
    assert not any(b"snorkelling" in path.read_bytes() for path in out.rglob("*") if path.is_file())
    assert verify(out).refused == 0


def test_an_agreement_is_to_the_items_and_what_is_no_answer_to_one_today_is_not_shared(
    study: MadeStudy, tmp_path: Path
) -> None:
    run(study, ["3", "shoes", "10", "bog snorkelling"])
    enrolling.sharing(study.file, "01", True, root=study.root)
    dataset = checks.load_sound(study.root)
    text = study.file.read_text("utf-8").replace("most = 7", "most = 2")
    text = text.replace('question = "What was it like?"\nanswer = "text"', 'question = "?"\nanswer = "number"')
    (tmp_path / "changed.toml").write_text(text, "utf-8")
    changed = replace(dataset, protocol=files.load(tmp_path / "changed.toml"))
    assert sharing._chosen(dataset, ["01"])[0] == ["01"]
    with pytest.raises(RosterError):
        sharing._chosen(changed, ["01"])
    tables = phenotype.shared(tmp_path, changed, {"01": "07"}, "PARTICIPANT")
    table = {path.name: content.decode().split("\n")[1] for path, content in tables.items() if path.suffix == ".tsv"}
    assert table == {"before.tsv": "sub-07\tn/a\tshoes", "afterwards.tsv": "sub-07\t10\tn/a"}


@pytest.fixture(scope="module")
def touching(tmp_path_factory: pytest.TempPathFactory) -> MadeStudy:
    shared = SHARING.replace('facts = ["age", "sex"]', 'questionnaires = ["touch"]')
    place = tmp_path_factory.mktemp("touched") / "study"
    study = make_study(place, sessions=0, enrolled=2, further=asking(shared, TOUCH))
    rig = place / "rig.toml"
    text = shipped("rigs/rehearsal.toml").read_text("utf-8").replace("format = 2", "format = 6")
    rig.write_text(f'{text}\n[contactor]\npart = "panel"\narea_mm2 = 9000.0\n', "utf-8")
    response = shipped("rigs/rehearsal-response.csv")
    shutil.copy(response, place / response.name)
    run(study, ["31,5", "sock", "standing"], rig_file=rig)
    run(study, ["30.5", "2", "", "left-over"], participant="02", rig_file=rig)
    build.build(study.root)
    return study


def test_what_the_skin_touched_is_asked_before_a_task_and_stands_in_its_sidecar(touching: MadeStudy) -> None:
    assert answers(touching) == {
        "touch.skin_temperature": 31.5,
        "touch.footwear": "sock",
        "touch.posture": "standing",
    }
    assert not (touching.root / "phenotype").exists()
    sidecar = json.loads((touching.root / "sub-01" / "beh" / "sub-01_task-virtual_events.json").read_text("utf-8"))
    assert sidecar["Contactor"] == {"part": "panel", "area_mm2": 9000.0}
    assert {name: one["Value"] for name, one in sidecar["Touch"].items()} == {
        "skin_temperature": 31.5,
        "footwear": "sock",
        "posture": "standing",
    }
    assert sidecar["Touch"]["skin_temperature"]["Units"] == "°C"


def test_methods_say_what_the_skin_touched_each_number_with_its_row(touching: MadeStudy, tmp_path: Path) -> None:
    found = analyse((touching.root,), tmp_path / "out", figures=False)
    rows = [*csv.DictReader((tmp_path / "out" / "tables" / "touched.csv").read_text("utf-8-sig").splitlines())]
    by_name = {(row["of"], row["value"]): row for row in rows}
    assert by_name["contact area", ""]["mean"] == "9000.0"
    warm = by_name["skin temperature", ""]
    # By hand: 31.5 and 30.5.
    assert (warm["sessions"], warm["mean"], round(float(warm["sd"]), 4)) == ("2", "31.0", 0.7071)
    assert by_name["footwear", "sock"]["sessions"] == "2"
    assert not any(row["of"] == "posture" for row in rows)
    line = 2 + rows.index(warm)
    (sentence,) = (one for one in " ".join(found.write_up(92).split()).split(". ") if f"{{touched.csv {line}}}" in one)
    assert re.findall(r"[0-9]+\.[0-9]+", sentence) == ["31.00", "0.71"]


def test_a_copy_for_others_has_what_the_skin_touched_without_texts(touching: MadeStudy, tmp_path: Path) -> None:
    licensed(touching)
    for label in ("01", "02"):
        enrolling.sharing(touching.file, label, True, root=touching.root)
    build.build(touching.root)
    out = sharing.share(touching.root, tmp_path / "copy").root
    sidecars = [json.loads(path.read_text("utf-8")) for path in out.glob("sub-*/beh/*_events.json")]
    assert sorted(one["Touch"]["skin_temperature"]["Value"] for one in sidecars) == [30.5, 31.5]
    assert [[*one["Touch"]] for one in sidecars] == [["skin_temperature", "footwear"]] * 2
    assert verify(out).refused == 0


def test_a_session_without_questionnaires_writes_none(tmp_path: Path) -> None:
    plain = make_study(tmp_path / "plain", sessions=1)
    assert not (plain.root / "phenotype").exists()
