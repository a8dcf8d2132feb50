"""A control apart from the tasks it controls: at chance, above it, or open; tests as R counts them."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import pandas as pd
import pytest

import palpate as library
from palpate.analysis.analyse import analyse
from palpate.analysis.conditions.control import Controlled, apart
from palpate.analysis.export import CONTROL, files
from palpate.analysis.power import simulate
from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.study import Study
from palpate.experiment import storage
from palpate.experiment.protocol import files as protocols
from palpate.experiment.protocol import new
from palpate.experiment.protocol.files import shipped
from tests.analysis.datasets import MATERIALS, balanced, trials, write_dataset

MANY = 15


def dataset(root: Path, right: Sequence[int], each: int = 24) -> Path:
    """A study whose control has so many right answers of `each` from each participant, and its protocol."""
    sessions = {}
    for place, count in enumerate(right, start=1):
        shown = [MATERIALS[n % 3] for n in range(each)]
        said = [one if n < count else MATERIALS[(n + 1) % 3] for n, one in enumerate(shown)]
        control = trials(zip(shown, said, strict=True))
        sessions[f"{place:02d}"] = {"virtual": balanced(place), "control": control}
    write_dataset(root, sessions, tasks=("virtual", "control"))
    study = new.NewStudy("lab", "A study", len(right), new.materials(MATERIALS), "virtual", 4)
    storage.write_bytes(root / "sourcedata" / "protocol.toml", new.controlled(new.text(study)).encode())
    return root


def found(root: Path) -> Controlled:
    _, (one,) = apart(read(root))
    return one


def test_a_control_at_chance_is_told_before_the_answers_and_is_in_no_other_section(tmp_path: Path) -> None:
    root = dataset(tmp_path, [8] * MANY)
    rest, _ = apart(read(root))
    assert {task.id for task in rest.tasks} == {*rest.attempts["task"], *rest.designs} == {"virtual"}
    made = analyse((root,), figures=False)
    assert made.sections[0].paragraphs[0] == found(root).sentence
    assert json.loads((made.out / "results.json").read_text("utf-8"))["control"][0]["right"] == 8 * MANY
    files = {path.stem for path in (made.out / "tables").iterdir() if b"control" in path.read_bytes()}
    assert files == {"control", "answers"}
    assert made.write_up(92).count("{control.csv") == 1


def test_shares_and_tests_are_those_of_r(tmp_path: Path) -> None:
    one = found(dataset(tmp_path, [12, 9, 7, 10, 8, 11]))
    assert (one.right, one.trials, one.margin) == (57, 144, 0.1)
    assert one.chance == pytest.approx(1 / 3)
    # R 4.2.2: binom.test(57, 144, 1/3, "greater"), and binom.test(12, 24, 1/3, "greater") times 6 (Holm).
    assert one.p_binomial == pytest.approx(0.06786463464, rel=1e-6)
    assert one.p_single == pytest.approx(0.4059526742, rel=1e-6)
    assert one.above == ()


@pytest.mark.parametrize(
    ("right", "verdict", "above"),
    [
        ([8] * MANY, "at chance", ()),
        ([11] * MANY, "above chance", ()),
        ([20, *[8] * (MANY - 1)], "above chance", ("01",)),
        ([8] * 3, "not shown", ()),
        ([0] * 3, "at chance", ()),
    ],
    ids=["guesses", "all-a-little", "one-hears", "few", "never-right"],
)
def test_verdicts(tmp_path: Path, right: Sequence[int], verdict: str, above: tuple[str, ...]) -> None:
    one = found(dataset(tmp_path, right))
    assert (one.verdict, one.above) == (verdict, above)


def test_a_study_of_a_control_alone_is_left_as_it_is(tmp_path: Path) -> None:
    study = read(dataset(tmp_path, [8, 8]))
    study.attempts.loc[study.attempts["task"] == "virtual", "included"] = False
    rest, controls = apart(study)
    assert (rest, controls) == (study, ())


def test_a_control_has_the_columns_of_factors_as_well(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study = read(dataset(tmp_path, [8] * 3))
    frequencies = {name: {"frequency": 40.0 * place} for place, name in enumerate(study.materials, 1)}
    monkeypatch.setattr(Study, "factors", frequencies)
    exported = {name: pd.read_csv(io.BytesIO(content)) for name, content in files(study).items()}
    for name in ("trials.csv", CONTROL):
        wanted = [frequencies[one]["frequency"] for one in exported[name]["presented"]]
        assert exported[name]["presented_frequency"].tolist() == wanted


def test_a_control_is_apart_in_a_notebook_in_exported_tables_and_in_power(tmp_path: Path) -> None:
    root = dataset(tmp_path / "data", [8] * 3)
    assert set(library.identify(read(root)).to_frame()["task"]) == {"virtual"}
    assert set(read(root).attempts["task"]) == {"virtual", "control"}
    exported = {name: pd.read_csv(io.BytesIO(content)) for name, content in files(read(root)).items()}
    assert set(exported[CONTROL]["task"]) == {"control"}
    assert exported[CONTROL]["correct"].sum() == 24
    assert list(exported[CONTROL]) == list(exported["trials.csv"])
    assert set(exported["trials.csv"]["task"]) == set(exported["long.csv"]["task"]) == {"virtual"}
    assert not [name for name in exported["wide.csv"] if str(name).startswith("control")]
    file = tmp_path / "study.toml"
    file.write_text(new.controlled(shipped("okamoto2012.toml").read_text("utf-8")), "utf-8")
    planned, model = simulate.prepare(protocols.load(file), "okamoto2012")
    assert [task.id for task in planned.tasks] == ["virtual", "real"]
    found_by = simulate.run(
        protocols.load(file),
        planned,
        model,
        participants=[4],
        studies=2,
        seed=1,
        target=0.8,
        runner=partial(simulate.on_cores, jobs=1),
    )
    assert {row.kind for row in found_by.rows} == {"model", "guessing"}
