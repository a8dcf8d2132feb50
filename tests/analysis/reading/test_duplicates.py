"""Nobody counts twice in a pooled analysis, and nobody is taken for somebody else."""

from __future__ import annotations

import random
import re
from collections.abc import Mapping
from pathlib import Path

import pytest

from palpate.analysis.reading.pooled import read_pooled
from palpate.experiment.errors import DatasetError
from tests.analysis.datasets import MATERIALS, balanced, trials, write_dataset
from tests.approved import Refuses

Rows = list[dict[str, object]]
People = Mapping[str, Mapping[str, Rows]]


def _measured(seed: int) -> Rows:
    """A session with response times and speeds as palpate writes them."""
    draw = random.Random(seed)
    return [
        {**row, "response_time": round(draw.uniform(0.5, 3), 6), "foot_speed": round(draw.uniform(80, 300), 3)}
        for row in balanced(seed)
    ]


def _people(first: int) -> dict[str, dict[str, Rows]]:
    return {f"{k:02d}": {"virtual": _measured(first + k), "real": _measured(first + 50 + k)} for k in range(1, 4)}


NORTH = _people(0)


def _ids(people: People, seed: int) -> dict[tuple[str, str], str]:
    """An id for every session, as a journal's header has it."""
    draw = random.Random(seed)
    return {(who, task): draw.randbytes(16).hex() for who, by_task in people.items() for task in by_task}


IDS = _ids(NORTH, 0)


@pytest.mark.parametrize(
    ("copy", "source", "named"),
    [
        ({who: NORTH[who] for who in ("01", "03")}, {}, "01, 03 ("),
        ({who: {"real": by_task["real"]} for who, by_task in NORTH.items()}, {}, "01, 02, 03 ("),
        ({"01": NORTH["01"], "07": NORTH["02"]}, {"07": "02"}, "01, 02 (there 07) ("),
        ({"02": {"virtual": NORTH["02"]["virtual"][:3]}, "09": _people(200)["01"]}, {}, "02 ("),
        ({"02": {"virtual": NORTH["02"]["virtual"][5:]}}, {}, "02 ("),
        ({"02": {"virtual": [{**row, "answered": "sand"} for row in NORTH["02"]["virtual"]]}}, {}, "02 ("),
        ({"04": {"real": NORTH["01"]["real"]}}, {"04": "01"}, "01 (there 04) ("),
    ],
    ids=["some people", "one task", "another label", "begun", "without the first", "answers mended", "one session"],
)
def test_a_session_counts_once_under_its_id(
    tmp_path: Path, copy: People, source: Mapping[str, str], named: str
) -> None:
    """`source` says whose sessions a label of the copy holds, where it is not the label's own."""
    own = _ids(copy, 1)
    ids = {(who, task): IDS.get((source.get(who, who), task), own[who, task]) for who, task in own}
    roots = [
        write_dataset(tmp_path / "north", NORTH, session_ids=IDS),
        write_dataset(tmp_path / "copy", copy, session_ids=ids),
    ]
    for order, said in ((roots, named), (roots[::-1], "")):
        message = f"{order[0].name} and {order[1].name} contain the same trials of {said}"
        with pytest.raises(DatasetError, match=re.escape(message)) as refused:
            read_pooled(order)
        assert "by the ids of their sessions" in str(refused.value)


def test_sessions_with_ids_of_their_own_are_pooled_however_alike(tmp_path: Path) -> None:
    roots = [
        write_dataset(tmp_path / "a", NORTH, session_ids=IDS),
        write_dataset(tmp_path / "b", NORTH, session_ids=_ids(NORTH, 1)),
    ]
    assert len(read_pooled(roots).participants) == 6


def test_an_id_twice_in_one_dataset_is_refused(tmp_path: Path, refuses: Refuses) -> None:
    ids = dict.fromkeys([("01", "virtual"), ("02", "virtual")], "0" * 32)
    root = write_dataset(tmp_path / "north", NORTH, session_ids=ids)
    with refuses(DatasetError):
        read_pooled([root])


def test_of_many_people_a_few_are_named(tmp_path: Path, refuses: Refuses) -> None:
    many = {f"{k:02d}": {"real": _measured(k)} for k in range(1, 9)}
    fewer = {who: rows for who, rows in many.items() if who != "08"}
    with refuses(DatasetError):
        read_pooled([write_dataset(tmp_path / "a", many), write_dataset(tmp_path / "b", fewer)])


def test_a_copy_from_before_ids_is_told_by_its_trials(tmp_path: Path, refuses: Refuses) -> None:
    roots = [write_dataset(tmp_path / "a", NORTH, session_ids=IDS), write_dataset(tmp_path / "b", NORTH)]
    with refuses(DatasetError):
        read_pooled(roots)


def test_other_people_with_the_same_answers_are_pooled(tmp_path: Path) -> None:
    """Labels, orders and answers alike, times not: a protocol that fixes the order, in two labs."""
    others = {
        who: {task: [{**row, "response_time": 0.1 + n} for n, row in enumerate(rows)] for task, rows in by_task.items()}
        for who, by_task in NORTH.items()
    }
    pooled = read_pooled([write_dataset(tmp_path / "a", NORTH), write_dataset(tmp_path / "b", others)])
    assert len(pooled.participants) == 6


PERFECT = trials((material, material) for material in MATERIALS for _ in range(4))


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        ({"1": balanced(1), "2": balanced(2), "3": PERFECT}, {"1": balanced(1), "2": balanced(2)}, "1, 2"),
        ({"1": balanced(1), "2": balanced(2)}, {"1": balanced(1), "2": balanced(3)}, ""),
        ({"1": balanced(1), "2": balanced(2)}, {"3": balanced(1), "4": balanced(2)}, ""),
        ({"1": PERFECT, "2": balanced(2)}, {"1": PERFECT, "2": balanced(3), "3": PERFECT}, ""),
    ],
    ids=["some people", "one of two", "other labels", "without mistakes"],
)
def test_answers_alone_tell_a_participant_by_identical_trials(
    tmp_path: Path, first: Mapping[str, Rows], second: Mapping[str, Rows], same: str, refuses: Refuses
) -> None:
    roots = [
        write_dataset(tmp_path / name, {who: {"real": rows} for who, rows in held.items()}, origin="RECONSTRUCTION")
        for name, held in (("a", first), ("b", second))
    ]
    if same:
        with refuses(DatasetError):
            read_pooled(roots)
    else:
        assert len(read_pooled(roots).participants) == len(first) + len(second)
