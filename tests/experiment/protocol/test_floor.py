"""A footstep protocol whose floor is what participants were measured not to feel."""

from __future__ import annotations

import csv
import hashlib
from pathlib import Path

import pytest

from palpate.analysis import export
from palpate.analysis.reading.dataset import read
from palpate.experiment.errors import ProtocolError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import ProtocolFile, shipped
from palpate.experiment.protocol.kinds import floor, kind_of
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.protocol.kinds.presented import Presented
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.page import page
from palpate.experiment.session.kinds.footstep.preparation import floor_m_s2
from tests.analysis.designs.detection.sample import TRACK, dataset, two_rows
from tests.experiment.protocol.small import SMALL

THRESHOLDS = """\
dataset,participant,task,frequency_hz,threshold_rms_m_s2,floor_rms_m_s2,beyond
measured,sub-01,sole,10.0,0.25,0.2,
measured,sub-01,sole,100.0,0.15,0.11,
measured,sub-02,sole,10.0,0.09,0.07,
measured,sub-02,sole,100.0,NA,NA,above the highest level
measured,sub-03,sole,100.0,0.9,0.8,
"""


def named(folder: Path, whose: str, text: str = THRESHOLDS) -> Protocol:
    """The small study, whose floor of 0.4 m/s^2 is measured."""
    (folder / "thresholds.csv").write_text(text, "utf-8")
    sha256 = hashlib.sha256(text.encode()).hexdigest()
    measured = f'measured = {{ file = "thresholds.csv", sha256 = "{sha256}", whose = "{whose}" }}'
    study = SMALL.replace("format = 4", "format = 7").replace("floor_m_s2 = 0.4", f"floor_m_s2 = 0.4\n{measured}")
    file = folder / "study.toml"
    file.write_text(study, "utf-8")
    return files.load(file)


@pytest.mark.parametrize(
    ("whose", "participant", "rms_m_s2"),
    [
        ("everybody", "01", 0.07),
        ("everybody", None, 0.07),
        ("participant", "01", 0.11),
        ("participant", "02", 0.07),
        # Never above the floor that the board read.
        ("participant", "03", 0.4),
        ("participant", None, 0.4),
    ],
)
def test_the_floor_is_the_least_that_may_have_been_felt(
    whose: str, participant: str | None, rms_m_s2: float, tmp_path: Path
) -> None:
    protocol = named(tmp_path, whose)
    assert kind_of("footstep").floor_m_s2(protocol, participant) == rms_m_s2
    assert floor_m_s2(protocol, participant) == rms_m_s2


def test_plan_states_the_range_of_the_participants_floors(tmp_path: Path) -> None:
    assert floor.range_m_s2(named(tmp_path, "participant")) == (0.07, 0.4)
    assert floor.range_m_s2(named(tmp_path, "everybody")) == (0.07, 0.07)


@pytest.mark.parametrize("beyond", ["below the lowest level", ""])
def test_who_may_have_felt_less_than_was_measured_has_no_floor(beyond: str, tmp_path: Path) -> None:
    text = THRESHOLDS.replace("above the highest level", beyond)
    with pytest.raises(ProtocolError) as error:
        floor_m_s2(named(tmp_path, "everybody", text))
    assert error.value.findings[0].field == "file"
    protocol = named(tmp_path, "participant", text)
    assert floor_m_s2(protocol, "01") == 0.11
    with pytest.raises(ProtocolError) as error:
        floor_m_s2(protocol, "02")
    assert error.value.findings[0].field == "participant"


def test_the_thresholds_that_export_writes_are_a_floor(tmp_path: Path) -> None:
    files_of = export.files(read(dataset(tmp_path / "detected", 2, {"1": two_rows(TRACK), "2": two_rows("+" * 18)})))
    (tmp_path / "study").mkdir()
    text = files_of["thresholds.csv"].decode()
    known, below = csv.DictReader(text.splitlines())
    protocol = named(tmp_path / "study", "participant", text)
    assert floor_m_s2(protocol, "1") == min(0.4, float(known["floor_rms_m_s2"]))
    # All of the second's answers were right, so the track went down to the lowest level and stayed there.
    assert (below["floor_rms_m_s2"], below["beyond"].split()[0]) == ("NA", "below")
    with pytest.raises(ProtocolError):
        floor_m_s2(protocol, "2")


def test_without_thresholds_the_floor_is_the_protocols(tmp_path: Path) -> None:
    protocol = named(tmp_path, "everybody")
    own = protocol.table(Footstep)
    without = own.model_copy(update={"tactile": own.tactile.model_copy(update={"measured": None})})
    plain = protocol.model_copy(update={"footstep": without})
    assert (kind_of("footstep").floor_m_s2(plain, "01"), floor_m_s2(plain, "01")) == (None, 0.4)
    assert plain.companions == {}


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("participant,floor\nsub-01,0.1\n", "file"),
        (THRESHOLDS.replace("0.2,\n", "0.2,,7\n"), "file"),
        ("dataset,participant,frequency_hz,floor_rms_m_s2,beyond\nmeasured,sub-01,10.0,NA,\n", "file"),
    ],
)
def test_another_table_is_no_floor(text: str, field: str, tmp_path: Path) -> None:
    with pytest.raises(ProtocolError) as error:
        floor_m_s2(named(tmp_path, "everybody", text))
    assert error.value.findings[0].field == field


def test_nobody_has_the_floor_of_another_participant_or_of_another_file(tmp_path: Path) -> None:
    protocol = named(tmp_path, "participant")
    with pytest.raises(ProtocolError) as error:
        floor_m_s2(protocol, "07")
    assert (error.value.findings[0].field, error.value.findings[0].got) == ("participant", "07")
    (tmp_path / "thresholds.csv").write_text(THRESHOLDS.replace("0.07", "0.3"), "utf-8")
    with pytest.raises(ProtocolError) as error:
        floor_m_s2(protocol, "01")
    assert error.value.findings[0].field == "sha256"


def test_what_a_rehearsal_felt_is_no_participants_floor(tmp_path: Path) -> None:
    floor.refuse_simulated(named(tmp_path, "everybody"))
    with pytest.raises(ProtocolError):
        floor.refuse_simulated(named(tmp_path, "everybody", THRESHOLDS.replace("measured,sub-03", "REHEARSAL,sub-03")))


def test_the_board_reads_whose_thresholds_and_the_hash_of_their_file(tmp_path: Path) -> None:
    pages = {whose: page(named(tmp_path, whose), "study.toml") for whose in ("everybody", "participant")}
    sha256 = hashlib.sha256(THRESHOLDS.encode()).hexdigest()
    assert all(sha256[:32] in "".join(one.split()) for one in pages.values())
    assert pages["everybody"] != pages["participant"]


def test_the_shipped_study_of_the_sole_presents_sinusoids_from_10_to_500_hz() -> None:
    file = shipped("sole.toml")
    protocol = files.load(file)
    assert isinstance(protocol, ProtocolFile)
    assert len(file.read_text("utf-8").splitlines()) <= 150
    tones = [numbers["frequency_hz"] for numbers in protocol.table(Presented).numbers.values() if len(numbers) == 3]
    assert (min(tones), max(tones), len(tones)) == (10.0, 500.0, len(protocol.materials) - 1)
