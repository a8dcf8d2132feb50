"""Nobody counts twice in a pooled analysis, and nobody is taken for somebody else."""

from __future__ import annotations

import random
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis.reading.pooling import Sessions, held_twice, read_pooled
from experiment.errors import DatasetError
from tests.analysis.datasets import MATERIALS, balanced, trials, write_dataset

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


@pytest.mark.parametrize(
    ("copy", "named"),
    [
        ({who: NORTH[who] for who in ("01", "03")}, "01, 03;"),
        ({who: {"real": by_task["real"]} for who, by_task in NORTH.items()}, "01, 02, 03;"),
        ({"01": NORTH["01"], "07": NORTH["02"]}, "01, 02 (there 07);"),
        ({"02": {"virtual": NORTH["02"]["virtual"][:3]}, "01": _people(200)["01"]}, "02;"),
        ({"02": {"virtual": NORTH["02"]["virtual"][5:]}}, "02;"),
        ({"02": {"virtual": [{**row, "answered": "sand"} for row in NORTH["02"]["virtual"]]}}, "02;"),
        ({f"{k:02d}": {"real": NORTH["01"]["real"]} for k in (4, 5)}, "01 (there 04);"),
    ],
    ids=["some people", "one task", "another label", "begun", "without the first", "answers mended", "copied twice"],
)
def test_measured_trials_count_once(tmp_path: Path, copy: People, named: str) -> None:
    roots = [write_dataset(tmp_path / "north", NORTH), write_dataset(tmp_path / "copy", copy)]
    for order, said in ((roots, named), (roots[::-1], "")):
        message = f"{order[0].name} and {order[1].name} hold the same trials of {said}"
        with pytest.raises(DatasetError, match=re.escape(message)):
            read_pooled(order)


def test_of_many_people_a_few_are_named(tmp_path: Path) -> None:
    many = {f"{k:02d}": {"real": _measured(k)} for k in range(1, 9)}
    fewer = {who: rows for who, rows in many.items() if who != "08"}
    with pytest.raises(DatasetError, match=r"of 01, 02, 03, 04, 05 and 2 more; give each participant once"):
        read_pooled([write_dataset(tmp_path / "a", many), write_dataset(tmp_path / "b", fewer)])


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
        ({"1": balanced(1), "2": balanced(2), "3": PERFECT}, {"1": balanced(1), "2": balanced(2)}, True),
        ({"1": balanced(1), "2": balanced(2)}, {"1": balanced(1)[:9], "2": balanced(2)[:9], "4": balanced(3)}, True),
        ({"1": balanced(1), "2": balanced(2)}, {"1": balanced(1), "2": balanced(3)}, False),
        ({"1": balanced(1), "2": balanced(2)}, {"3": balanced(1), "4": balanced(2)}, False),
        ({"1": balanced(1), "2": PERFECT}, {"1": balanced(1), "2": PERFECT, "3": PERFECT}, False),
    ],
    ids=["some people", "begun", "one of two", "other labels", "without mistakes"],
)
def test_answers_alone_tell_people_where_several_agree(
    tmp_path: Path, first: Mapping[str, Rows], second: Mapping[str, Rows], same: bool
) -> None:
    roots = [
        write_dataset(tmp_path / name, {who: {"real": rows} for who, rows in held.items()}, origin="RECONSTRUCTION")
        for name, held in (("a", first), ("b", second))
    ]
    if same:
        with pytest.raises(DatasetError, match="a and b hold the same trials of 1, 2; give each participant once"):
            read_pooled(roots)
    else:
        assert len(read_pooled(roots).participants) == len(first) + len(second)


def _sessions(held: Mapping[str, Sequence[int]]) -> Sessions:
    return Sessions({(who, "real"): frozenset((one,) for one in attempts) for who, attempts in held.items()}, {})


@given(st.lists(st.lists(st.integers(0, 10**6), min_size=1), unique_by=tuple, max_size=6), st.data())
def test_any_part_of_anybody_is_found_under_any_name(people: list[list[int]], data: st.DataObject) -> None:
    """Attempts are numbered by who made them, so nobody shares one with anybody else."""
    whole = {f"p{k}": [10**7 * k + one for one in attempts] for k, attempts in enumerate(people)}
    taken = data.draw(st.sets(st.sampled_from(sorted(whole)))) if whole else set()
    parts = {f"q{who}": data.draw(st.lists(st.sampled_from(whole[who]), min_size=1)) for who in sorted(taken)}
    first, second = _sessions(whole), _sessions(parts)
    assert held_twice(first, second) == {who: f"q{who}" for who in taken}
    assert held_twice(second, first) == {f"q{who}": who for who in taken}
