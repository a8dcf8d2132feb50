"""A file of palpate's that is given for another is named, once, with the command that checks it."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import pytest

from palpate.experiment.apparatus import rig
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.errors import PalpateError, Remedy
from palpate.experiment.protocol import files
from palpate.experiment.protocol.approval import Seal, sealing
from palpate.experiment.protocol.files import ProtocolFile, shipped
from palpate.experiment.rehearsal.wires import modes
from palpate.experiment.settings.load import Confined
from palpate.experiment.settings.other_files import error
from tests.experiment.protocol.small import SMALL

RIGS = ("rigs/rehearsal.toml", "rigs/laboratory.toml", "rigs/presented.toml", "rigs/tapping.toml", "rigs/weight.toml")


def command(caught: PalpateError) -> tuple[str, ...]:
    (one,) = caught.findings
    assert isinstance(one.remedy, Remedy)
    assert "\n" not in str(caught)
    return one.remedy.command


@pytest.mark.parametrize("name", RIGS)
def test_a_rig_in_a_protocols_place(name: str) -> None:
    path = shipped(name)
    with pytest.raises(PalpateError) as caught:
        files.load(path)
    assert command(caught.value) == ("palpate", "doctor", "--rig", str(path))


def test_a_protocol_in_a_rigs_place_or_a_panels() -> None:
    path = shipped("ahead.toml")
    for load in (rig.load, modes.read):
        with pytest.raises(PalpateError) as caught:
            load(path)
        assert command(caught.value) == ("palpate", "check", str(path))


def test_a_seal_in_its_protocols_place(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(SMALL, encoding="utf-8")
    day = date(2020, 2, 1)
    sealing.write(
        path,
        files.load(path),
        approval_number="7",
        board="Board of tests",
        approved_on=day,
        expires_on=date(2021, 2, 1),
    )
    with pytest.raises(PalpateError) as caught:
        files.load(tmp_path / "study.seal.toml")
    assert command(caught.value) == ("palpate", "check", str(path))


@pytest.mark.parametrize("model", [Rig, ProtocolFile, Seal])
def test_a_file_of_no_kind_and_one_of_its_own_kind_have_their_own_problems(model: type[Confined]) -> None:
    own = {name: 1 for name, field in model.model_fields.items() if field.is_required()}
    assert error(Path("a.toml"), model, {"colour": 1}) is None
    assert error(Path("a.toml"), model, own) is None
