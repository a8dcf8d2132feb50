"""The validation: published numbers, what is written, and what is refused."""

from __future__ import annotations

import csv
import json
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.reading import dissimilarities
from palpate.analysis.validation import report, validate
from palpate.analysis.validation.report import sections
from palpate.experiment.errors import DatasetError, RecordingError
from palpate.experiment.synthesis.crinkle import Average
from palpate.experiment.synthesis.spectra import spectrum
from tests.analysis.validation.test_dissimilarity import FRESH, SPEEDS, Takes, linear
from tests.approved import Refuses

PAPER = ("copy paper", "aluminum foil", "polypropylene", "typing paper")


def of_the_paper(speeds: np.ndarray, takes: int, *, simulated: bool = False) -> Takes:
    """The four materials, of different loudness, on one panel."""
    one = linear(speeds, takes)
    objects = {name: (1 + place) * one.objects["card"] for place, name in enumerate(PAPER)}
    return Takes(speeds, one.panel, objects, simulated=simulated)


def test_table_3_is_that_of_the_reference_file(reference: Path) -> None:
    with (reference / "okamoto2012_table3.csv").open(encoding="utf-8", newline="") as file:
        rows = {frozenset((r["material_a"], r["material_b"])): float(r["dissimilarity"]) for r in csv.DictReader(file)}
    assert {pair: value.value for pair, value in dissimilarities.load().pairs.items()} == rows
    assert dissimilarities.load().speed_mm_s == 200  # section 6.1


def test_the_counts_of_the_text() -> None:
    """Section 3.3: six of ten trials at 150 mm/s were put on 150 mm/s, three on 100 mm/s."""
    assert dissimilarities.load().counts == (("copy paper", 150.0, 150.0, 6), ("copy paper", 150.0, 100.0, 3))


def test_confusions_are_those_of_table_2() -> None:
    made = validate.compute(of_the_paper(SPEEDS, 3), of_the_paper(FRESH, 10))
    ratios = {(point.presented, point.answered): point.ratio for point in made.confusable}
    assert len(ratios) == 12
    assert ratios["typing paper", "aluminum foil"] == 0.36  # Table 2
    assert ratios["polypropylene", "copy paper"] == 0
    oracle = stats.spearmanr(list(ratios.values()), [point.dissimilarity for point in made.confusable]).statistic
    assert made.rank_correlation == pytest.approx(oracle)
    assert made.holds


def test_materials_that_the_paper_has_not_are_compared_with_one_another_alone(approved: SnapshotAssertion) -> None:
    made = validate.compute(linear(SPEEDS, 3), linear(FRESH, 10))
    assert (made.confusable, made.rank_correlation, made.pairs) == ((), None, {})
    assert sections(made)[-1].paragraphs[0] == approved


def test_simulated_recordings_are_said_to_be_fitted_wherever_they_stand_beside_the_paper(tmp_path: Path) -> None:
    recorded, fresh = of_the_paper(SPEEDS, 3, simulated=True), of_the_paper(FRESH, 10, simulated=True)
    made = report.validate(recorded, fresh, tmp_path, figures=False)
    told = "Agreement with Table 3, with Figure 7, and with the rank correlation of Table 2 was therefore built in"
    for slug in ("classification", "dissimilarity"):
        assert told in " ".join((tmp_path / "tables" / f"{slug}.md").read_text("utf-8").split())
    assert " ".join(made.text().split()).count(told) == 2
    assert " ".join(made.report.read_text("utf-8").split()).count(told) == 2
    assert told in json.loads((tmp_path / "results.json").read_text("utf-8"))["fitted"]
    drawn = {one.name: one.figure for one in report.sheets(made.validation)}
    assert "fitted to Table 3" in str(drawn["confusions"].get_suptitle()).replace("\n", " ")


@pytest.mark.parametrize(("average", "other"), [("magnitude", "signed"), ("signed", "magnitude")])
def test_takes_are_averaged_as_asked_and_the_other_average_is_told(
    average: Average, other: Average, approved: SnapshotAssertion
) -> None:
    """Each is computed by hand from equations (1) and (2)."""
    rng = np.random.default_rng(4)
    recorded, fresh = of_the_paper(SPEEDS, 3), of_the_paper(FRESH, 10)
    for name, takes in recorded.objects.items():
        recorded.objects[name] = takes + rng.normal(0, 0.5, takes.shape)
    made = validate.compute(recorded, fresh, average=average)
    assert (made.average, made.other.average) == (average, other)

    def at_200(takes: np.ndarray, how: Average) -> np.ndarray:
        c = spectrum(takes[2])
        return np.asarray(np.abs(c.mean(axis=0)) if how == "signed" else np.abs(c).mean(axis=0))

    for how, pairs in ((average, made.pairs), (other, made.other.pairs)):
        own = {n: np.maximum(at_200(t, how) - at_200(recorded.panel, how), 0) for n, t in recorded.objects.items()}
        # 40 bins of 5 Hz: all lie below 500 Hz.
        scores = {(a, b): np.abs(own[a] - own[b]).sum() for a, b in pairs}
        assert pairs == {pair: pytest.approx(score / max(scores.values())) for pair, score in scores.items()}
    assert made.pairs != made.other.pairs
    swapped = validate.compute(recorded, fresh, average=other)
    assert (swapped.pairs, swapped.rank_correlation) == (made.other.pairs, made.other.rank_correlation)
    told = " ".join(" ".join(section.paragraphs) for section in sections(made))
    assert told == approved


def test_materials_compared_beyond_the_recorded_speeds_are_said_to_be_extrapolated() -> None:
    slow = np.array([50.0, 100.0, 150.0])
    for speeds, extrapolated in ((slow, True), (SPEEDS, False)):
        made = validate.compute(linear(speeds, 3), linear(FRESH, 10))
        assert made.extrapolated is extrapolated
        assert report.numbers(made)["reference_extrapolated"] is extrapolated
        assert ("EXTRAPOLATED" in " ".join(sections(made)[-1].paragraphs)) is extrapolated


def test_takes_that_were_put_elsewhere_are_said_not_to_hold(approved: SnapshotAssertion) -> None:
    fresh = linear(FRESH, 10)
    fresh.objects["card"][:] *= 0.01
    made = validate.compute(linear(SPEEDS, 3), fresh)
    assert not made.holds
    text = " ".join(sections(made)[0].paragraphs)
    assert text == approved


def test_without_a_speed_between_recorded_ones_there_is_no_overlay() -> None:
    made = validate.compute(linear(SPEEDS, 3), linear(np.array([100.0, 400.0]), 2))
    assert made.overlays == ()
    assert [section.slug for section in sections(made)] == ["classification", "dissimilarity"]


class Outside(HTMLParser):
    """Collects what a page would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("src", "href", "xlink:href") and value and not value.startswith("#"):
                self.fetched.append(value)


def test_what_is_written_is_whole_and_says_what_it_is(tmp_path: Path) -> None:
    recorded, fresh = of_the_paper(SPEEDS, 3, simulated=True), of_the_paper(FRESH, 10, simulated=True)
    made = report.validate(recorded, fresh, tmp_path / "out")
    names = {str(path.relative_to(tmp_path / "out")) for path in made.files}
    figures = {f"figures/{name}.{kind}" for name in ("classification", "overlay", "spectra", "confusions")
               for kind in ("svg", "png")}  # fmt: skip
    parts = ("classification", "overlay", "dissimilarity")
    tables = {f"tables/{name}.{kind}" for name in parts for kind in ("csv", "md", "tex")}
    assert names == figures | tables | {"results.json", "report.html", "methods.html"}
    page = made.report.read_text("utf-8")
    parser = Outside()
    parser.feed(page)
    assert parser.fetched == ["methods.html"]
    assert page.count("<figure") == 4
    for name in tables:
        assert "SIMULATED" in (tmp_path / "out" / name).read_text("utf-8")
    assert "SIMULATED" in page
    assert json.loads((tmp_path / "out" / "results.json").read_text("utf-8"))["label"] == "SIMULATED"
    assert made.text().startswith("SIMULATED")
    assert "copy paper: 30 of 30" in " ".join(made.text().split())
    with (tmp_path / "out" / "tables" / "classification.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 * 3 * 10
    assert {row["chosen_mm_s"] for row in rows if row["observed_mm_s"] == "250.0"} == {"250.0"}


def test_real_recordings_are_not_called_simulated(tmp_path: Path) -> None:
    made = report.validate(linear(SPEEDS, 3), linear(FRESH, 10), tmp_path / "out", figures=False)
    assert "SIMULATED" not in made.text() + made.report.read_text("utf-8")
    json.dumps(made.as_dict(), allow_nan=False)


def test_a_second_run_gives_the_same_bytes(tmp_path: Path) -> None:
    contents = []
    for _ in range(2):
        made = report.validate(of_the_paper(SPEEDS, 3), of_the_paper(FRESH, 10), tmp_path / "out")
        contents.append({path: path.read_bytes() for path in made.files})
    assert contents[0] == contents[1]


def test_a_file_in_the_way_stays(tmp_path: Path, refuses: Refuses) -> None:
    (tmp_path / "report.html").write_text("mine")
    with refuses(DatasetError):
        report.validate(linear(SPEEDS, 3), linear(FRESH, 10), tmp_path, figures=False)
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


@pytest.mark.parametrize(
    ("recorded", "fresh", "error", "message"),
    [
        (
            of_the_paper(SPEEDS, 3, simulated=True),
            of_the_paper(FRESH, 2),
            RecordingError,
            "SIMULATED recordings and real",
        ),
        (linear(SPEEDS, 3), of_the_paper(FRESH, 2), RecordingError, "fresh takes: got none of card"),
        (
            linear(np.array([100.0]), 3),
            linear(FRESH, 2),
            RecordingError,
            "got takes at one speed, 100 mm/s",
        ),
    ],
)
def test_what_does_not_compare_is_refused_and_nothing_is_written(
    tmp_path: Path, recorded: Takes, fresh: Takes, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        report.validate(recorded, fresh, tmp_path / "out", figures=False)
    assert not (tmp_path / "out").exists()
