"""Reasons on record: none names a participant or about health."""

from __future__ import annotations

from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.errors import RosterError
from palpate.experiment.study import people
from palpate.experiment.study.people import keeping
from tests.approved import Refuses
from tests.conftest import Palpate
from tests.experiment.dataset.studies import MadeStudy, make_study


@pytest.mark.parametrize(
    "reason",
    [
        "asked to stop",
        "moved away",
        "no time any more",
        "the panel broke",
        "did not come back",
        "the paint and the psychophysics lab",
    ],
)
def test_a_reason_that_tells_of_nobody_passes(reason: str) -> None:
    people.check_reason(reason, ["Ann Uebermut", "O. Li"])


@pytest.mark.parametrize(
    "reason",
    ["felt ill", "Headache", "has epilepsy", "a COVID test", "pain in the foot", "her doctor said so", "ear ache"],
)
def test_a_reason_that_tells_of_health_is_refused_and_not_repeated(reason: str) -> None:
    with pytest.raises(RosterError, match="about health") as refused:
        people.check_reason(f"secret and {reason}", [])
    assert "secret" not in str(refused.value)


@pytest.mark.parametrize("reason", ["Ann asked to stop", "asked by mr. \u00dcBERMUT"])
def test_a_reason_that_names_a_participant_is_refused(reason: str, refuses: Refuses) -> None:
    with refuses(RosterError) as refused:
        people.check_reason(reason, ["", "Ann \u00dcbermut"])
    assert "bermut" not in str(refused.value).casefold()


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> MadeStudy:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    return make_study(tmp_path / "study", sessions=0)


@pytest.mark.parametrize(
    "command", [("withdraw", "-p", "01"), ("consent", "-p", "01", "--correct", "--consent-on", "2001-09-08")]
)
def test_nothing_is_on_record_after_a_refused_reason(
    study: MadeStudy, palpate: Palpate, command: tuple[str, ...], approved: SnapshotAssertion
) -> None:
    keeping.keep(study.protocol, study.root, "02", people.Person(name="Ann Example"))
    before = {path: path.read_bytes() for path in study.root.rglob("*") if path.is_file() and path.suffix != ".lock"}
    name, *options = command
    for reason in ("felt sick", "told ann"):
        code, _, err = palpate(name, study.file, *options, "--dataset", study.root, "--reason", reason)
        assert (code, err.count("\n")) == (2, 1)
        assert err == approved
    assert before == {path: path.read_bytes() for path in before}
    assert palpate(name, study.file, *options, "--dataset", study.root, "--reason", "asked to stop")[0] == 0
