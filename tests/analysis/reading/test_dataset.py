"""Reading datasets: what is read, and one line for everything that cannot be."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.pooled import read_pooled
from palpate.experiment.dataset.register import LOG, Anchor, Kept
from palpate.experiment.errors import DatasetError
from palpate.experiment.records.events import NO_ANSWER
from palpate.experiment.settings.characters import hidden
from tests.analysis.datasets import MATERIALS, balanced, trial, trials, write_dataset
from tests.approved import Refuses

EVENTS = Path("sub-02/beh/sub-02_task-virtual_events.tsv")
SIDECAR = EVENTS.with_suffix(".json")


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    sessions = {"01": {"virtual": balanced(1), "real": balanced(2)}, "02": {"virtual": balanced(3)}}
    return write_dataset(tmp_path / "data", sessions)


def test_what_was_written_is_read(dataset: Path) -> None:
    study = read(dataset)
    assert (study.id, study.origin, study.label, study.materials) == ("lab", "PARTICIPANT", "", MATERIALS)
    assert [task.id for task in study.tasks] == ["virtual", "real"]
    assert study.tasks[0].title == "The virtual task"
    assert study.participants == ("01", "02")
    assert len(study.trials("virtual")) == 24
    assert len(study.trials("real")) == 12
    assert study.exclusions == ()
    assert [part.protocol for part in study.parts] == [None]


SOME: dict[str, tuple[str, ...]] = {"virtual": ("glass", "sand")}


def test_what_a_task_presents_is_read_and_nothing_else_may_stand_in_its_rows(tmp_path: Path, refuses: Refuses) -> None:
    sessions = {"01": {"virtual": trials([("glass", "snow")]), "real": balanced(2)}}
    study = read(write_dataset(tmp_path / "some", sessions, presented=SOME))
    assert [task.presented for task in study.tasks] == [("glass", "sand"), MATERIALS]
    wrong = {"01": {"virtual": trials([("glass", "snow"), ("snow", "snow")])}}
    with refuses(DatasetError):
        read(write_dataset(tmp_path / "wrong", wrong, presented=SOME))


@pytest.mark.parametrize("told", ['["snow", "sand"]', '["ice"]', "[]", '"sand"'])
def test_a_sidecar_that_presents_what_cannot_be_is_refused(tmp_path: Path, told: str, refuses: Refuses) -> None:
    root = write_dataset(tmp_path / "data", {"02": {"virtual": trials([("glass", "snow")])}}, presented=SOME)
    document = json.loads((root / SIDECAR).read_text("utf-8"))
    (root / SIDECAR).write_text(json.dumps(document | {"Presented": json.loads(told)}), "utf-8")
    with refuses(DatasetError):
        read(root)


def test_sessions_of_one_task_present_the_same(tmp_path: Path, refuses: Refuses) -> None:
    rows = {"virtual": trials([("glass", "snow")])}
    root = write_dataset(tmp_path / "data", {"01": rows, "02": rows}, presented=SOME)
    document = json.loads((root / SIDECAR).read_text("utf-8"))
    (root / SIDECAR).write_text(json.dumps(document | {"Presented": ["glass"]}), "utf-8")
    with refuses(DatasetError):
        read(root)
    other = write_dataset(tmp_path / "other", {"03": {"virtual": balanced(1)}})
    write_dataset(root, {"01": rows, "02": rows}, presented=SOME)
    with refuses(DatasetError):
        read_pooled([root, other])


def test_numbers_and_missing_values_are_read(tmp_path: Path) -> None:
    rows = [trial(1, "sand", NO_ANSWER, foot_speed=123.25, frames_lost=2, response_time=0.75), trial(2, "sand", "snow")]
    attempts = read(write_dataset(tmp_path, {"1": {"real": rows}})).attempts
    assert attempts["foot_speed_mm_s"].tolist()[0] == 123.25
    assert attempts["frames_lost"].isna().tolist() == [False, True]
    assert attempts["answered"].tolist() == [NO_ANSWER, "snow"]


def test_a_task_without_sessions_is_left_out(tmp_path: Path) -> None:
    study = read(write_dataset(tmp_path, {"1": {"real": balanced(1)}}))
    assert [task.id for task in study.tasks] == ["real"]


def _replace(old: str, new: str) -> Callable[[str], str]:
    return lambda text: text.replace(old, new, 1)


def _first_row(column: int, cell: str) -> Callable[[str], str]:
    def change(text: str) -> str:
        lines = text.split("\n")
        cells = lines[1].split("\t")
        cells[column] = cell
        return "\n".join([lines[0], "\t".join(cells), *lines[2:]])

    return change


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("dataset_description.json", lambda _: "{", "line 1 is not JSON"),
        ("dataset_description.json", lambda _: "[]", "got list; allowed: a JSON object"),
        ("dataset_description.json", _replace('"Palpate"', '"Other"'), "key Palpate needs"),
        ("dataset_description.json", _replace('"PARTICIPANT"', '"GUESS"'), "Origin is 'GUESS'; allowed: PARTICIPANT"),
        ("dataset_description.json", _replace('"virtual"', '"tapping"'), "its task is not in dataset_description.json"),
        ("dataset_description.json", _replace('"Tasks": [', '"Tasks": 3, "Other": ['), "Tasks is 3; allowed"),
        ("participants.tsv", _replace("participant_id", "who"), "the column participant_id is missing"),
        ("participants.tsv", _replace("sub-02", "sub-01"), "participant 01 is listed twice"),
        ("participants.tsv", _replace("sub-02", "sub-03"), "participant 02 is not in participants.tsv"),
        (SIDECAR, _replace('"Materials"', '"Stuff"'), "Materials is None; allowed"),
        (SIDECAR, _replace('"glass",', '"ice",'), "Materials differ from those of other files"),
        (SIDECAR, _replace('"Kind": "footstep"', '"Kind": "walk"'), "Kind is 'walk'; allowed: footstep, tapping"),
        (SIDECAR, _replace('"identification"', '"guess"'), "Design is 'guess'; allowed: identification, comparison"),
        (SIDECAR, _replace('"identification"', '"comparison"'), "Design is 'comparison'; allowed: a design for"),
        (SIDECAR, _replace('"Rows": 12', '"Rows": "12"'), "Rows is '12'; allowed"),
        (EVENTS, _replace("presented\t", "shown\t"), "missing columns: presented"),
        (EVENTS, _first_row(2, "0"), "line 2: trial: got '0'; allowed: a whole number from 1"),
        (EVENTS, _first_row(2, "2"), "line 3: trial 2 counts twice"),
        (EVENTS, _first_row(4, "yes"), "line 2: counted: got 'yes'; allowed: 0, 1"),
        (EVENTS, _first_row(5, "ice"), "line 2: presented: got 'ice'; allowed: glass, sand, snow"),
        (EVENTS, _first_row(6, "ice"), "line 2: answered: got 'ice'; allowed: glass, sand, snow, (none)"),
        (EVENTS, _first_row(6, "n/a"), "line 2: answered: got 'n/a'"),
        (EVENTS, _first_row(7, "-3"), "line 2: response_time: got '-3'; allowed: a number from 0, or n/a"),
        (EVENTS, _first_row(7, "1e999"), "line 2: response_time: got '1e999'; allowed: a number from 0"),
        (EVENTS, _first_row(8, "fast"), "line 2: foot_speed: got 'fast'; allowed: a number from 0, or n/a"),
        (EVENTS, _first_row(8, "-0.5"), "line 2: foot_speed: got '-0.5'; allowed: a number from 0"),
        (EVENTS, _first_row(9, "1.5"), "line 2: frames_lost: got '1.5'; allowed: a whole number from 0, or n/a"),
        (EVENTS, _first_row(9, "1e300"), "line 2: frames_lost: got '1e300'; allowed: a whole number from 0"),
        (EVENTS, _first_row(9, "-1"), "line 2: frames_lost: got '-1'; allowed: a whole number from 0"),
        (EVENTS, _first_row(11, "0.5"), "line 2: delivered: got '0.5'; allowed: 0, 1, or n/a"),
        (EVENTS, _first_row(12, "nan"), "line 2: onset_error: got 'nan'; allowed: a number, or n/a"),
        (EVENTS, _first_row(8, "inf"), "line 2: foot_speed: got 'inf'"),
        (EVENTS, _first_row(14, "REHEARSAL"), "line 2: origin: got 'REHEARSAL'; allowed: PARTICIPANT"),
        (EVENTS, lambda text: text.replace("\t1\t1\t1\t", "\t1\t", 1), "line 2: 13 cells in 15 columns"),
        (EVENTS, lambda text: text.rsplit("\n", 2)[0] + "\n", "11 rows, its sidecar lists 12"),
        (EVENTS, lambda text: text[:-5], "ends in the middle of a line; it is truncated"),
    ],
)
def test_a_broken_file_is_one_line_with_file_and_remedy(
    dataset: Path, file: str | Path, change: Callable[[str], str], message: str
) -> None:
    path = dataset / file
    path.write_text(change(path.read_text()))
    with pytest.raises(DatasetError, match=re.escape(message)) as error:
        read(dataset)
    assert Path(file).name in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("file", ["dataset_description.json", "participants.tsv", SIDECAR])
def test_a_missing_file_is_named(dataset: Path, file: str | Path) -> None:
    (dataset / file).unlink()
    with pytest.raises(DatasetError, match="is missing"):
        read(dataset)


@pytest.mark.parametrize("left", [SIDECAR.name, "sub-02_task-virtual_recording-foot_physio.tsv.gz"])
def test_what_is_left_of_a_session_tells_that_its_events_are_missing(dataset: Path, left: str) -> None:
    for path in (EVENTS, SIDECAR):
        (dataset / path).unlink()
    (dataset / EVENTS).with_name(left).touch()
    message = rf"{EVENTS} is missing, but {left} exists; restore it"
    with pytest.raises(DatasetError, match=message):
        read(dataset)
    (dataset / EVENTS).with_name(left).unlink()
    assert "02" in read(dataset).participants


def test_an_onset_may_come_before_contact_and_times_may_be_zero(tmp_path: Path) -> None:
    rows = [trial(1, "sand", "sand", onset_error=-0.002, response_time=0, foot_speed=0, frames_lost=0, delivered=False)]
    attempts = read(write_dataset(tmp_path, {"1": {"real": rows}})).attempts
    columns = ["onset_error_s", "response_time_s", "foot_speed_mm_s", "frames_lost", "delivered"]
    assert attempts[columns].iloc[0].tolist() == [-0.002, 0, 0, 0, 0]


def test_a_folder_without_trials_is_refused(tmp_path: Path, refuses: Refuses) -> None:
    with refuses(DatasetError):
        read(write_dataset(tmp_path, {"01": {}}))


def test_a_hidden_character_is_refused_in_every_file(tmp_path: Path) -> None:
    rows = [trial(1, "sand", "sand")]
    for place, (file, old, new) in enumerate(
        (
            ("dataset_description.json", '"A study"', '"A \\u202estudy"'),
            ("sub-1/beh/sub-1_task-real_events.json", '"some sand"', '"some \\u001b[2Jsand"'),
            ("sub-1/beh/sub-1_task-real_events.tsv", "n/a", "\u200b"),
            ("participants.tsv", "participant_id", "participant_id\x1b"),
        )
    ):
        root = write_dataset(tmp_path / str(place), {"1": {"real": rows}})
        text = (root / file).read_text("utf-8")
        assert old in text
        (root / file).write_text(text.replace(old, new, 1), "utf-8")
        with pytest.raises(
            DatasetError, match=rf"{file}: got '.* with U\+(202E|001B|200B); allowed: text without"
        ) as told:
            read(root)
        assert not hidden(str(told.value))


def test_text_in_another_encoding_is_refused(dataset: Path) -> None:
    (dataset / "participants.tsv").write_bytes(b"\xff\xfe")
    with pytest.raises(DatasetError, match="cannot be read"):
        read(dataset)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_no_truncation_passes_unseen(dataset: Path, data: st.DataObject) -> None:
    path = dataset / data.draw(st.sampled_from([str(EVENTS), str(SIDECAR), "dataset_description.json"]))
    whole = path.read_bytes()
    path.write_bytes(whole[: data.draw(st.integers(0, len(whole) - 2))])
    try:
        with pytest.raises(DatasetError):
            read(dataset)
    finally:
        path.write_bytes(whole)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_no_damage_is_more_than_one_line(dataset: Path, data: st.DataObject) -> None:
    names = [str(EVENTS), str(SIDECAR), "dataset_description.json", "participants.tsv"]
    path = dataset / data.draw(st.sampled_from(names))
    whole = path.read_bytes()
    place = data.draw(st.integers(0, len(whole) - 1))
    path.write_bytes(whole[:place] + data.draw(st.binary(max_size=3)) + whole[place + data.draw(st.integers(0, 3)) :])
    message = ""
    try:
        read(dataset)
    except DatasetError as error:
        message = str(error)
    finally:
        path.write_bytes(whole)
    assert "\n" not in message


def test_the_sidecar_lists_the_materials_in_order(dataset: Path) -> None:
    assert json.loads((dataset / SIDECAR).read_text())["Materials"] == list(MATERIALS)


def test_attempts_done_again_may_have_no_answer(tmp_path: Path) -> None:
    rows = [trial(1, "sand", "n/a", counted=False, redo_reason="foot slipped"), trial(1, "sand", "sand", attempt=2)]
    study = read(write_dataset(tmp_path, {"1": {"real": [*rows, *trials([("snow", "snow")])[0:0]]}}))
    assert study.attempts["included"].tolist() == [False, True]


def test_the_anchors_of_a_dataset_are_those_of_a_lab_book(tmp_path: Path) -> None:
    root = write_dataset(tmp_path, {"1": {"virtual": trials([("glass", "sand")])}}, tasks=("virtual",))
    assert read(root).parts[0].anchors == ()
    anchor = Anchor(
        anchored_utc="2026-05-01T10:00:00+00:00",
        study="lab",
        purpose="STUDY",
        protocol_sha256="0" * 64,
        seal_sha256=None,
        prefixes=(),
    )
    (root / LOG).parent.mkdir(exist_ok=True)
    (root / LOG).write_text(f"{Kept(anchor=anchor).model_dump_json()}\ntorn\n", "utf-8")
    day, *_, number = anchor.line.split()
    assert read(root).parts[0].anchors == (f"{day} {number}",)
