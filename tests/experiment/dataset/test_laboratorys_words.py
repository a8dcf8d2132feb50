"""What a laboratory writes into a dataset's description and README stays when its tables are made again. SIMULATED."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from palpate.experiment.dataset import build, verify
from palpate.experiment.errors import DatasetError
from palpate.experiment.study import withdrawal
from tests.experiment.dataset.studies import MadeStudy, make_study

# The example of ORCID's documentation, "Structure of the ORCID Identifier".
AUTHOR = "J. Carberry (ORCID 0000-0002-1825-0097)"
WRITTEN: dict[str, Any] = {
    "Authors": [AUTHOR],
    "License": "CC-BY-4.0",
    "Funding": ["Grant 1"],
    "Keywords": ["vibrotactile"],
    "DatasetDOI": "doi:10.0000/x",
    "InstitutionName": "A university",
}


@pytest.fixture
def study(tmp_path: Path) -> MadeStudy:
    return make_study(tmp_path / "study")


def described(study: MadeStudy, **changed: object) -> dict[str, Any]:
    """The description, with these keys changed."""
    path = study.root / "dataset_description.json"
    content: dict[str, Any] = json.loads(path.read_text("utf-8")) | changed
    path.write_text(json.dumps(content), "utf-8")
    return content


def test_every_key_of_a_laboratory_and_its_readme_stay(study: MadeStudy) -> None:
    described(study, **WRITTEN)
    readme = study.root / "README"
    readme.write_text(f"{readme.read_text('utf-8')}\nRoom 1, with the window shut.\n", "utf-8")
    had = readme.read_text("utf-8")
    withdrawal.withdraw(study.file, "02", "asked to stop", root=study.root, rebuild=build.build)
    assert described(study) == described(study) | WRITTEN
    assert readme.read_text("utf-8") == had
    assert verify.verify(study.root).refused == 0


def test_the_approvals_of_the_board_are_added_to_those_that_a_laboratory_names(study: MadeStudy) -> None:
    board = "Ethical committee of the School of Engineering, Nagoya University: 17, 2001-01-01 to 2099-01-01"
    assert described(study)["EthicsApprovals"] == [board]
    described(study, EthicsApprovals=["Another board: 3"])
    build.build(study.root)
    assert described(study)["EthicsApprovals"] == ["Another board: 3", board]


@pytest.mark.parametrize(
    ("written", "line"),
    [(b'{\n "Authors": ["J. Carberry",]\n}\n', 2), (b"[]\n", None), (b'{"Authors": ["\xff"]}\n', None)],
    ids=["comma", "list", "encoding"],
)
def test_a_description_that_cannot_be_read_is_refused_and_not_overwritten(
    study: MadeStudy, written: bytes, line: int | None
) -> None:
    path = study.root / "dataset_description.json"
    path.write_bytes(written)
    with pytest.raises(DatasetError) as error:
        build.build(study.root)
    assert (error.value.finding.where, error.value.finding.line) == (path, line)
    assert path.read_bytes() == written
    assert [one.where for one in verify.verify(study.root).findings if one.refuses] == [path.name]
    path.unlink()
    build.build(study.root)
    assert verify.verify(study.root).refused == 0


@pytest.mark.parametrize(
    ("key", "value"),
    [("Authors", "J. Carberry"), ("Funding", [1]), ("Authors", ["J. Carberry (0000-0002-1825-0098)"])],
    ids=["text", "number", "ORCID"],
)
def test_what_bids_does_not_allow_is_refused_and_not_overwritten(study: MadeStudy, key: str, value: object) -> None:
    written = described(study, **{key: value})
    with pytest.raises(DatasetError, match=key):
        build.build(study.root)
    assert described(study) == written
