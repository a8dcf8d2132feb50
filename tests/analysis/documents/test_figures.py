"""Figures at the width of a column: no letters over letters or beyond the edge, none too small; odd datasets too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.text import Annotation
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.documents import drawing
from palpate.analysis.documents.drawing import COLOURS, PAGE_INCHES, Sheet, name_beside, sheet, svg, told_apart
from palpate.analysis.documents.flow import flow
from palpate.analysis.identification.results import compute
from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.dissimilarities import NO_DISSIMILARITIES, Dissimilarities, printed_dissimilarities
from palpate.analysis.reading.pooled import read_pooled
from palpate.analysis.report.figures import sheets
from tests.analysis.datasets import MATERIALS, trials, write_dataset
from tests.analysis.legible import check

OKAMOTO = ("copy paper", "aluminum foil", "polypropylene", "typing paper")


def _study(root: Path, people: int, tasks: Sequence[str], materials: Sequence[str], **odd: str) -> Path:
    rng = np.random.default_rng(4)

    def session() -> list[dict[str, object]]:
        shown = [material for material in materials for _ in range(6)]
        said = [
            material
            if rng.random() < 0.6
            else str(rng.choice([*materials, "(none)"] if "unanswered" in odd else materials))
            for material in shown
        ]
        rows = trials(zip(shown, said, strict=True))
        return [
            {
                **row,
                "foot_speed": 150.0 if "still" in odd else round(float(rng.uniform(40, 400)), 1),
                "onset_error": round(float(rng.normal(0, 5e-4)), 6),
                "masker_level": 60.0 + int(rng.integers(8)),
            }
            for row in rows
        ]

    sessions: Mapping[str, Mapping[str, Sequence[Mapping[str, object]]]] = {
        f"{who:02}": {task: session() for task in tasks} for who in range(1, people + 1)
    }
    return write_dataset(root, sessions, materials=materials, tasks=tasks)


def _sheets(root: Path, dissimilarities: Dissimilarities = NO_DISSIMILARITIES) -> tuple[Sheet, ...]:
    study = read(root)
    return sheets(compute(study, {}, dissimilarities), study.label)


LONG = ("a sheet of very thin and crackling aluminum foil", "polypropylene", "snow", "typing paper of an office")
MANY = tuple(f"material {letter}" for letter in "abcdefghij")


@pytest.mark.parametrize(
    ("people", "tasks", "materials", "odd"),
    [
        (1, ("virtual", "real"), OKAMOTO, {}),
        (15, ("virtual", "real"), OKAMOTO, {"unanswered": "yes"}),
        (30, ("only",), MATERIALS, {"still": "yes"}),
        (7, ("virtual", "real"), LONG, {"unanswered": "yes"}),
        (6, ("one", "two", "three"), MANY, {}),
        (4, ("one",), MATERIALS[:2], {}),
    ],
)
def test_letters_stand_clear_of_one_another(
    tmp_path: Path, people: int, tasks: Sequence[str], materials: Sequence[str], odd: Mapping[str, str]
) -> None:
    found = _sheets(_study(tmp_path, people, tasks, materials, **odd))
    names = {one.name for one in found}
    assert {"correct-ratios", "confusion", "learning", "speed", "onset-errors", "masker"} <= names
    assert max(one.figure.get_figheight() for one in found) <= PAGE_INCHES + 0.5
    assert all("(n = " in one.caption or "participants" in one.caption or "trials" in one.caption for one in found)
    check(found)
    below = [one.figure.axes for one in found if one.name in ("correct-ratios", "confusion", "marginal-means")]
    named = {
        label.get_text().strip().replace("\n", " ")
        for all_axes in below
        for one in all_axes
        for label in one.get_xticklabels()
    }
    # No word is broken.
    assert named <= {*told_apart(materials, 26), "(none)"}
    levels = {label.get_text().startswith("\n") for one in below[0] for label in one.get_xticklabels()}
    # On one level where breaking between words is enough, and never slanted.
    assert levels == ({False, True} if "polypropylene" in materials else {False})
    assert {label.get_rotation() for of in below for one in of for label in one.get_xticklabels()} == {0.0}


def test_a_dollar_sign_in_a_name_is_no_formula(tmp_path: Path) -> None:
    names = (r"foil $\frac$", "$1 sheet$", "$")
    found = _sheets(_study(tmp_path, 2, ("real",), names, unanswered="yes"))
    assert all(svg(one.figure) for one in found)
    confusion = next(one for one in found if one.name == "confusion").figure
    assert set(names) <= {text.get_text() for text in confusion.axes[0].get_yticklabels()}


def test_a_title_stands_inside_of_a_figure_for_slides_alone(tmp_path: Path) -> None:
    study = read(_study(tmp_path, 2, ("real",), MATERIALS))
    results = compute(study, {}, NO_DISSIMILARITIES)
    for label in ("", "REHEARSAL"):
        bare, titled = sheets(results, label), sheets(results, label, titles=True)
        assert {one.figure.get_suptitle() for one in bare} == {label}
        assert all(one.figure.get_suptitle().removeprefix(label).strip() for one in titled)
        taller = [(a.figure.get_figheight(), b.figure.get_figheight()) for a, b in zip(bare, titled, strict=True)]
        assert all(a < b for a, b in taller)
    check(titled)


def test_the_published_studys_figures(repository_root: Path) -> None:
    found = _sheets(repository_root / "participants" / "okamoto2012", printed_dissimilarities())
    names = ["correct-ratios", "confusion", "map", "dissimilarity"]
    assert [one.name for one in found] == names
    check(found)


def test_names_of_materials_in_one_place_are_beside_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten materials, of which two are in one place and three near another: each name is written, clear of the rest."""
    points = np.vstack([np.random.default_rng(3).normal(0, 0.2, (7, 2)), [[0.5, 0.1], [0.5, 0.1], [0.49, 0.1]]])
    with mpl.rc_context(drawing.COLUMN_STYLE):
        figure, (axes,) = sheet([2.6], "", "")
        for point in points:
            axes.plot(*point, "o")
        assert name_beside(figure, axes, MANY)
        check([Sheet("map", "", "", figure)])
    named = [text for text in axes.texts if isinstance(text, Annotation)]
    assert [(text.get_text(), text.xy) for text in named] == list(zip(MANY, map(tuple, points), strict=True))
    assert {*MANY[7:]} <= {text.get_text() for text in named if text.arrow_patch}
    monkeypatch.setattr(drawing, "REACHES", (5.0, 12.0))
    other, (crowded,) = sheet([2.6], "", "")
    for _ in MANY * 3:
        crowded.plot(0, 0, "o")
    assert not name_beside(other, crowded, MANY * 3)
    assert not crowded.texts


def test_a_hundred_participants_are_four_pages_and_more_are_said(tmp_path: Path, approved: SnapshotAssertion) -> None:
    found = [one for one in _sheets(_study(tmp_path, 103, ("real",), MATERIALS)) if one.name.startswith("participants")]
    assert [one.name for one in found] == [f"participants-real{page}" for page in ("", "-2", "-3", "-4")]
    assert [one.caption for one in found] == approved
    check(found)


def _seen(colour: str, kind: str) -> np.ndarray:
    """The colour as seen without one kind of cones (Vienot, Brettel and Mollon 1999), linear RGB."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    to_lms = np.array([[17.8824, 43.5161, 4.11935], [3.45565, 27.1554, 3.86714], [0.0299566, 0.184309, 1.46709]])
    without = {
        "protan": np.array([[0, 2.02344, -2.52581], [0, 1, 0], [0, 0, 1]]),
        "deutan": np.array([[1, 0, 0], [0.494207, 0, 1.24827], [0, 0, 1]]),
    }[kind]
    seen = np.linalg.inv(to_lms) @ without @ to_lms @ linear
    return np.asarray(np.clip(seen, 0, 1) ** (1 / 2.4))


@pytest.mark.parametrize("kind", ["protan", "deutan"])
def test_colours_are_told_apart_without_red_or_green_cones(kind: str) -> None:
    """A tenth of full scale between any two, and between the first two, which most figures need, three tenths."""
    seen = [_seen(colour, kind) for colour in COLOURS]
    distances = {(i, j): float(np.linalg.norm(seen[i] - seen[j])) for i, j in combinations(range(len(seen)), 2)}
    assert min(distances.values()) > 0.1
    assert distances[0, 1] > 0.3


def test_what_differs_in_the_labels_of_pooled_participants_stays(tmp_path: Path) -> None:
    """Names that begin alike: every panel and every tick tells whose it is."""
    rng = np.random.default_rng(7)

    def session() -> list[dict[str, object]]:
        rows = trials((shown, str(rng.choice(MATERIALS))) for shown in MATERIALS * 6)
        return [{**row, "masker_level": 60.0 + int(rng.integers(8))} for row in rows]

    names = ("e_noisy_laboratory", "e_nosp12")
    roots = [
        write_dataset(tmp_path / name, {f"{who:02}": {"real": session()} for who in range(1, 7)}, tasks=("real",))
        for name in names
    ]
    found = {one.name: one for one in sheets(compute(read_pooled(roots), {}), "")}
    check(tuple(found.values()))
    panels = [text.get_text().partition("\n") for text in found["participants-real"].figure.axes[0].texts]
    ticks = [text.get_text() for text in found["masker"].figure.axes[0].get_xticklabels()]
    for shown in ([name for name, _, _ in panels], ticks):
        assert len(shown) == len(set(shown)) == 12
        assert {name[-2:] for name in shown} == {f"{who:02}" for who in range(1, 7)}


def test_a_short_label_is_shown_whole() -> None:
    assert told_apart(["01", "participant"], 11) == ["01", "participant"]


@pytest.mark.parametrize("arms", [0, 1, 2, 3, 4])
def test_a_flow_of_participants_is_legible(arms: int) -> None:
    aside = "Not in any order below: n = 10000\nto begin: 10000\nwithdrew before beginning: 0\nwithdrew, data erased: 0"
    counts = "\n".join(
        f"{what}: 10000" for what in ("completed", "under way", "withdrew", "doubted", "excluded by a rule")
    )
    stages = (
        ("Enrolment", ("Enrolled: n = 10000\n(planned: 10000)",)),
        ("Allocation", ("abcdefghijklmnopqrstuvwxyz\nthen short\nbegan: n = 10000",) * arms),
        ("Sessions", (counts,) * arms),
        ("Analysis", ("Available for analysis: at most n = 40000",)),
    )
    drawn = flow("REHEARSAL - simulated participants: study", LONG[0] * 4, aside, [one for one in stages if one[1]])
    check([Sheet("flow", "", "", drawn)])
