"""A whole analysis of ratings: means by participant, tests against R, power laws, tables and files."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

import palpate
from palpate.analysis.analyse import Analysis, analyse
from palpate.analysis.designs.rating import results
from palpate.analysis.export import files
from palpate.analysis.reading.dataset import read
from palpate.analysis.report import plan
from palpate.experiment.errors import DatasetError
from palpate.experiment.protocol.designs.rating import Rating
from tests.analysis.designs.rating.sample import MATERIALS, dataset
from tests.approved import anywhere


@pytest.fixture(scope="module")
def analysed(tmp_path_factory: pytest.TempPathFactory) -> Analysis:
    place = tmp_path_factory.mktemp("ratings")
    return analyse([dataset(place / "study")], place / "out")


def test_every_screen(analysed: Analysis, approved: SnapshotAssertion) -> None:
    text = analysed.text(full=True)
    assert anywhere(text, analysed.out.parent) == approved
    assert text.startswith("REHEARSAL")


def test_tests_over_participants_are_rs(analysed: Analysis) -> None:
    """R 4.2.2: means of 3 by 3; aov(m ~ material + Error(who / material)), and ICC(A,1) from its mean squares."""
    (task,) = analysed.results.tasks
    assert [one.means for one in task.people] == [(1.0, 2.0, 4.0), (2.0, 3.5, 5.0), (1.0, 3.0, 3.0)]
    assert (task.trials, task.unanswered) == (18, 1)
    assert task.repeated is not None
    assert (task.repeated.f, task.repeated.p_uncorrected) == pytest.approx(RS[:2], rel=1e-6)
    assert task.icc is not None
    assert task.icc.form("ICC(2,1)").value == pytest.approx(RS[2], rel=1e-6)


RS = (19.3, 0.0088165928277, 0.72619047619)


def test_exponents_are_of_geometric_means_of_each_participant(analysed: Analysis) -> None:
    """Of participant 1, who gave 1, 2 and 4 to magnitudes of 1, 2 and 4."""
    (task,) = analysed.results.tasks
    power = task.people[0].power
    assert power is not None
    assert (power.exponent, power.constant, power.r_squared) == pytest.approx((1.0, 0.0, 1.0))
    assert task.exponent is not None
    assert task.exponent.n == 3


def test_files_for_other_software_have_each_rating_and_each_mean(tmp_path: Path) -> None:
    written = files(read(dataset(tmp_path / "study")))
    rows = list(csv.DictReader(io.StringIO(written["trials.csv"].decode())))
    assert [row["rating"] for row in rows[-3:]] == ["NA", "1.0", "4.0"]
    assert {(row["presented"], row["magnitude"]) for row in rows} == {
        (material, str(2.0**place)) for place, material in enumerate(MATERIALS)
    }
    means = list(csv.DictReader(io.StringIO(written["ratings.csv"].decode())))
    assert len(means) == 9
    assert [row["mean"] for row in means[:3]] == ["1.0", "2.0", "4.0"]


def test_the_library_and_the_file_of_results_have_the_means(analysed: Analysis) -> None:
    frame = palpate.rate(read(analysed.datasets[0])).to_frame()
    assert frame["mean"].to_list() == pytest.approx([4 / 3, 8.5 / 3, 4.0])
    assert json.loads((analysed.out / "results.json").read_text("utf-8"))["quality"] == "roughness"


def test_ratings_that_are_no_numbers_are_refused(tmp_path: Path) -> None:
    study = read(dataset(tmp_path / "study", scale=("1", "2", "3", "4", "5", "a lot")))
    with pytest.raises(DatasetError):
        results.compute(study)


def test_a_table_of_several_tasks_has_the_mark_of_each_where_they_differ() -> None:
    planned = plan.Standing(frozenset({("power law", "one")}), frozenset(), frozenset())
    marks = dict(one.split(": ") for one in plan.mark_of(planned, "power law", ("one", "two")).split("; "))
    assert marks == {"one": "planned", "two": "exploratory"}
    assert plan.mark_of(planned, "power law", ("one",)) == "planned"


def test_datasets_whose_ratings_are_of_different_scales_are_not_pooled(tmp_path: Path) -> None:
    study = read(dataset(tmp_path))
    (part,) = study.parts
    assert part.protocol is not None
    other = part.protocol.model_copy(
        update={"rating": part.protocol.table(Rating).model_copy(update={"quality": "loudness"})}
    )
    results.compute(replace(study, parts=(part, part)))
    with pytest.raises(DatasetError) as refused:
        results.compute(replace(study, parts=(part, replace(part, protocol=other))))
    assert refused.value.finding.allowed == "one table [rating]"
