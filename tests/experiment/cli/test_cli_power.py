"""`palpate power`, as the analyst calls it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.protocol.files import shipped
from tests.conftest import Palpate

QUICK = ("--studies", "50", "--jobs", "1")


def test_power_prints_and_writes(palpate: Palpate, tmp_path: Path) -> None:
    code, out, err = palpate(
        "power", shipped("okamoto2012.toml"), *QUICK, "--participants", "4-5,15", "--out", tmp_path
    )
    assert code == 0
    assert out.startswith("SIMULATED studies")
    assert "4, 5, 15" in " ".join(out.split())
    assert (tmp_path / "power.png").is_file()
    assert "Traceback" not in err


def test_power_as_json_is_json_alone(palpate: Palpate) -> None:
    code, out, err = palpate(
        "power", shipped("okamoto2012.toml"), *QUICK, "--participants", "5", "--alpha", "0.01", "--seed", "3", "--json"
    )
    assert (code, err) == (0, "")
    document = json.loads(out)
    assert (document["label"], document["seed"], document["participants"]) == ("SIMULATED studies", 3, [5])
    assert {row["alpha"] for row in document["power_rows"]} == {0.01}
    assert sum(row["studies"] for row in document["power_rows"]) == 50 * len(document["power_rows"])


def test_power_from_a_dataset_tests_the_published_pair(palpate: Palpate, repository_root: Path) -> None:
    dataset = repository_root / "participants" / "okamoto2012"
    code, out, _ = palpate("power", shipped("okamoto2012.toml"), *QUICK, "--participants", "5", "--model", dataset)
    assert code == 0
    assert "RECONSTRUCTION" in out
    assert "foil and typing" in out


def test_power_with_looks_prints_and_writes(palpate: Palpate, tmp_path: Path) -> None:
    code, out, _ = palpate("power", shipped("okamoto2012.toml"), *QUICK, "--looks", "6,9", "--out", tmp_path)
    assert code == 0
    assert out.startswith("SIMULATED studies")
    assert "6, 9 participants" in out
    assert "SIMULATED studies" in (tmp_path / "looks.csv").read_text("utf-8")
    code, out, err = palpate("power", shipped("okamoto2012.toml"), *QUICK, "--looks", "6,9", "--json")
    assert (code, err) == (0, "")
    assert len(json.loads(out)["looks_rows"]) == 17


def test_power_of_comparisons_prints_and_has_no_looks(palpate: Palpate, approved: SnapshotAssertion) -> None:
    code, out, _ = palpate("power", shipped("wellman1995.toml"), *QUICK, "--participants", "5")
    assert code == 0
    assert "Bradley-Terry, live" in out
    code, _, err = palpate("power", shipped("wellman1995.toml"), *QUICK, "--looks", "5,8")
    assert code != 0
    assert err == approved


def test_a_model_is_refused_before_what_draws_is_loaded(palpate: Palpate, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "palpate.analysis.power.report", None)
    code, out, err = palpate("power", shipped("okamoto2012.toml"), "--model", "1.0,0.0")
    assert (code, out) == (2, "")
    assert "above 0 and below 1" in err


def test_a_step_that_the_model_itself_has_the_other_way_is_told(palpate: Palpate) -> None:
    _, out, _ = palpate("power", shipped("wellman1995.toml"), *QUICK, "--participants", "5", "--json")
    (told,) = (note for note in json.loads(out)["notes"] if "every step" in note)
    assert "In live, " in told


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--participants", "5-3"), "--participants: got '5-3'; allowed: whole numbers and ascending ranges"),
        (("--participants", "many"), "--participants: got 'many'; allowed"),
        (("--participants", ""), "--participants: got ''; allowed"),
        (("--alpha", "1"), "--alpha: got 1.0; allowed: a number between 0 and 1"),
        (("--alpha", "nan"), "--alpha: got nan; allowed"),
        (("--target", "0"), "--target: got 0.0; allowed"),
        (("--studies", "0"), "--studies: got 0; allowed"),
        (("--model", "nobody"), "--model nobody: got no model of that name"),
        (("--model", "no.toml"), "no such file"),
        (("--looks", "5"), "--looks: got 5; allowed: two or more increasing numbers of participants"),
        (("--looks", "many"), "--looks: got 'many'; allowed"),
        (("--looks", "5,8", "--rule", "guess"), "--rule: got guess; allowed: obrien-fleming, pocock, bayes"),
        (("--looks", "5,8", "--alike", "2"), "--alike: got 2.0; allowed: a number from 0 to 1"),
        (("--alike", "-1"), "--alike: got -1.0; allowed"),
    ],
)
def test_power_refuses_in_a_line(palpate: Palpate, arguments: tuple[str, ...], message: str) -> None:
    code, out, err = palpate("power", shipped("okamoto2012.toml"), *QUICK, *arguments)
    assert (code, out) == (2, "")
    assert message in err
    assert "Traceback" not in err


def test_a_scheduler_that_does_not_answer_is_named(palpate: Palpate, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    from palpate.analysis.power import simulate

    monkeypatch.setattr(simulate, "PATIENCE", "1s")
    code, _, err = palpate(
        "power", shipped("okamoto2012.toml"), *QUICK, "--participants", "4", "--scheduler", "tcp://127.0.0.1:9"
    )
    assert code == 2
    assert "--scheduler tcp://127.0.0.1:9: got" in err


def test_power_can_be_interrupted(palpate: Palpate, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from palpate.analysis.power import simulate

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(simulate, "simulate", interrupted)
    code, _, err = palpate("power", shipped("okamoto2012.toml"), *QUICK, "--out", tmp_path / "out")
    assert code == 130
    assert "nothing was written" in err
    assert not (tmp_path / "out").exists()


def test_a_rule_without_looks_is_refused(palpate: Palpate, approved: SnapshotAssertion) -> None:
    code, _, err = palpate("power", shipped("okamoto2012.toml"), *QUICK, "--rule", "pocock")
    assert code == 2
    assert err == approved
