"""Files of formats 2 and 3, whose kind `comparison` was tapping: the same study, the same form, under their seals."""

from __future__ import annotations

import re
from datetime import date
from pathlib import Path

import pytest

from palpate.experiment.errors import Finding, ProtocolError
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.approval import sealing
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.kinds.tapping import Tapping
from palpate.experiment.settings import load
from tests.conftest import REPOSITORY
from tests.experiment.protocol.small import SMALL

FOLDER = REPOSITORY / "tests" / "reference" / "protocols"
PAIRS, STEPS = FOLDER / "wellman1995-2.toml", FOLDER / "okamoto2012-3.toml"
"""The shipped protocols as they were."""


def refused(folder: Path, text: str) -> list[Finding]:
    """What is wrong in a file with this text."""
    file = folder / "study.toml"
    file.write_text(text, "utf-8")
    with pytest.raises(ProtocolError) as error:
        files.load(file)
    return list(error.value.findings)


def line_of(text: str, part: str) -> int:
    """The line on which a text that stands once begins."""
    assert text.count(part) == 1
    return text[: text.index(part)].count("\n") + 1


def live() -> str:
    """The older study of pairs with its live task alone."""
    text = PAIRS.read_text("utf-8")
    begin, end = text.index('[[tasks]]\nid = "virtual"'), text.index("# Exclusion rules")
    return (text[:begin] + text[end:]).replace('["live", "virtual"]', '["live"]')


@pytest.mark.parametrize(
    ("older", "number", "sha256"),
    [
        (PAIRS, 2, "f3d36fa13aefaf793ef4922506779410a7f3867783b20bcdaea3eca31eedd30d"),
        (STEPS, 3, "ae7fe9f39712a781377af40208fd683015873daf9ecaffa1afe21e8b7722b809"),
    ],
    ids=["pairs", "steps"],
)
def test_an_older_file_holds_the_shipped_study_and_has_the_form_that_it_had(
    older: Path, number: int, sha256: str
) -> None:
    study = files.load(older)
    newest = files.load(files.shipped(f"{study.study.id}.toml"))
    assert study.format == number
    assert study.model_copy(update={"format": newest.format}) == newest
    # Computed by the last palpate that had no format 4.
    assert approval.sha256(study) == sha256
    assert approval.sha256(newest) != sha256


def test_the_form_of_a_small_file_is_that_of_before_format_3(tmp_path: Path) -> None:
    file = tmp_path / "study.toml"
    file.write_text(SMALL.replace("format = 4", "format = 2").replace('design = "identification"\n', ""), "utf-8")
    # Computed by the last palpate that had no format 3.
    assert approval.sha256(files.load(file)) == "4b77d305cf9c2ac3de16e464a3e8b6fa0bb82218e15ee7faa806ac952d9df441"


def test_a_surface_of_an_older_study_that_only_lays_samples_out_stays_in_its_form(tmp_path: Path) -> None:
    file = tmp_path / "live.toml"
    file.write_text(live(), "utf-8")
    study = files.load(file)
    assert len(study.table(Tapping).surfaces) == 5
    # Computed by the last palpate that had no format 4.
    assert approval.sha256(study) == "177badf575d238ce943c760ae3aa57140fa1103630647efa52f721be74894563"


def test_an_older_file_runs_under_its_seal_and_what_was_changed_is_named_as_it_stands_there(tmp_path: Path) -> None:
    file = tmp_path / "study.toml"
    file.write_text(PAIRS.read_text("utf-8"), "utf-8")
    study = files.load(file)
    seal = sealing.write(
        file,
        study,
        approval_number="1",
        board=study.ethics.board,
        approved_on=date(2020, 2, 1),
        expires_on=date(2021, 2, 1),
    )
    assert approval.verify(file, files.load(file), date(2020, 6, 1)) == seal
    changed = PAIRS.read_text("utf-8").replace("attack_hz = 43.0", "attack_hz = 44.0")
    file.write_text(changed.replace("stiffness_n_m = 2500.0", "stiffness_n_m = 2400.0"), "utf-8")
    with pytest.raises(ProtocolError) as error:
        approval.verify(file, files.load(file), date(2020, 6, 1))
    fields = [one.field for one in error.value.findings]
    assert fields == ["protocol_sha256", "comparison.virtual.stiffness_n_m", "materials[0].attack_hz"]


@pytest.mark.parametrize(
    ("part", "instead", "field"),
    [
        ("rate_hz = 2500 ", "rate_hz = 1 ", "comparison.virtual.rate_hz"),
        ("attack_hz = 43.0", "attack_hz = -1.0", "materials[0].attack_hz"),
        ("amplitude = 0.033", 'amplitude = "loud"', "materials[0].amplitude"),
        ("amplitude = 0.033", "amplitudes = 0.033", "materials[0].amplitudes"),
        ('switch_key = "s"', 'switch_key = "1"', "comparison.virtual.switch_key"),
        ('stimulus = "real"', 'design = "comparison"\nstimulus = "real"', "tasks[0].design"),
    ],
)
def test_a_problem_of_an_older_file_is_told_where_it_stands(
    tmp_path: Path, part: str, instead: str, field: str
) -> None:
    text = PAIRS.read_text("utf-8").replace(part, instead)
    lines = {one.field: one.line for one in refused(tmp_path, text)}
    assert lines[field] == line_of(text, instead)


@pytest.mark.parametrize("kind", ["tapping", "unknown"])
def test_an_older_file_names_its_kinds_as_it_did(tmp_path: Path, kind: str) -> None:
    text = STEPS.read_text("utf-8").replace('kind = "footstep"', f'kind = "{kind}"')
    fields = {one.field for one in refused(tmp_path, text)}
    assert {"tasks[0].kind", "tasks[1].kind"} <= fields
    assert not {one for one in fields if "design" in one}


def test_the_table_of_a_newer_format_is_refused_in_an_older_file(tmp_path: Path) -> None:
    text = re.sub(r"(?m)^(attack_hz|amplitude) = .*\n", "", live())
    (problem,) = refused(tmp_path, newer := text.replace("[comparison.virtual]", "[tapping]"))
    assert (problem.field, problem.line) == ("tapping", line_of(newer, "[tapping]"))


@pytest.mark.parametrize(
    "document",
    [
        {"format": 3, "tasks": 1, "materials": "felt", "comparison": 2},
        {"format": 3, "tasks": (1, {"kind": 2}), "materials": (3, {}), "comparison": {"virtual": 4}},
        {"format": 2, "comparison": {"virtual": {}}},
        {"format": 2, "materials": ({"attack_hz": "x"}, 1), "comparison": {"virtual": {"surfaces": 1}}},
        {"format": 2, "tapping": {"surfaces": ({},)}, "comparison": {}},
    ],
)
def test_nonsense_of_an_older_format_is_refused_and_never_fails(document: dict[str, object]) -> None:
    assert load.find(ProtocolFile, document, {})
