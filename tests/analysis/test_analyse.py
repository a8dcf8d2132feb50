"""The whole analysis: the published study regenerates, and odd datasets get statements instead of NaN."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.analyse import Analysis, analyse
from palpate.analysis.identification.companion_tests import LINKED
from palpate.experiment.dataset.bids import LABELS
from palpate.experiment.errors import DatasetError
from palpate.experiment.records import software
from tests import formats
from tests.analysis.datasets import MATERIALS, balanced, trial, trials, write_dataset
from tests.approved import Refuses

OKAMOTO = ("copy paper", "aluminum foil", "polypropylene", "typing paper")


@pytest.fixture(scope="module")
def okamoto(repository_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Analysis:
    return analyse([repository_root / "participants" / "okamoto2012"], tmp_path_factory.mktemp("out"))


def _p(value: float | None) -> str:
    return f"{value:.2e}"


def test_the_virtual_tasks_tests_are_as_printed(okamoto: Analysis) -> None:
    """Okamoto, section 5.2."""
    task = okamoto.results.task("virtual")
    assert task is not None
    found = [(t.material, t.result.df, round(t.result.t or 0, 2), _p(t.result.p), t.result.stars) for t in task.tests]
    assert found == [
        ("copy paper", 14, 8.71, "5.02e-07", "***"),
        ("aluminum foil", 14, 2.75, "1.56e-02", "*"),
        ("polypropylene", 14, 5.79, "4.64e-05", "***"),
        ("typing paper", 14, 0.97, "3.46e-01", ""),
    ]


def test_the_real_tasks_tests_are_recomputed(okamoto: Analysis) -> None:
    """Recomputed values as in the README of the reference data."""
    task = okamoto.results.task("real")
    assert task is not None
    found = [(t.material, t.result.df, round(t.result.t or 0, 2), _p(t.result.p), t.result.stars) for t in task.tests]
    assert found == [
        ("copy paper", 9, 33.73, "8.72e-11", "***"),
        ("aluminum foil", 9, 3.77, "4.44e-03", "**"),
        ("polypropylene", 9, 4.81, "9.56e-04", "***"),
        ("typing paper", 9, 3.66, "5.26e-03", "**"),
    ]


def test_the_anovas_are_as_printed(okamoto: Analysis) -> None:
    pair = next(pair for pair in okamoto.results.pairs if pair.task == "virtual")
    assert pair.anova is not None
    effect = pair.anova.effects[0]
    assert pair.pair == ("aluminum foil", "typing paper")
    assert (effect.df, pair.anova.residual.df) == (3, 56)
    assert (round(effect.f or 0, 2), round(effect.p or 0, 2)) == (2.12, 0.11)
    assert [table.kind for table in okamoto.results.two_way] == [f"two-way, type {kind}" for kind in ("I", "II", "III")]
    for table in okamoto.results.two_way:
        task = table.effect("task")
        assert (task.df, table.residual.df, round(task.f or 0, 2)) == (1, 92, 7.49)
        assert task.p == pytest.approx(7.43e-3, abs=1e-5)


def test_the_variance_component_icc_is_that_of_the_reference(okamoto: Analysis) -> None:
    assert okamoto.results.components is not None
    k, meaning, value = okamoto.results.components.by_k[0]
    assert (k, round(value or 0, 3)) == (25, 0.968)
    assert "15 + 10" in meaning


def test_every_icc_says_which_matrix_it_is_of(okamoto: Analysis) -> None:
    found = [(r.icc.targets, r.icc.raters) for r in okamoto.results.reliabilities if r.icc]
    assert found == [(16, 15), (4, 15), (16, 10), (4, 10)]
    assert all(f"x {r.icc.raters} participants" in r.matrix for r in okamoto.results.reliabilities if r.icc)


def test_each_number_of_the_paragraphs_of_a_paper_has_its_row(okamoto: Analysis, approved: SnapshotAssertion) -> None:
    said = okamoto.write_up(100).replace(software.this().version, "N")
    assert said == approved
    cited = re.findall(r"\{(\w+\.csv) (\d+)\}", " ".join(said.split()))
    lines = {
        name: (okamoto.out / "tables" / name).read_text("utf-8").splitlines() for name in {name for name, _ in cited}
    }
    first, second = (lines[name][int(line) - 1].split(",") for name, line in cited[:2])
    assert first[-6:-4] == ["15", "600"]
    assert second[-6:-4] == ["10", "400"]
    found = [lines[name][int(line) - 1] for name, line in cited if name == "found.csv"]
    assert [line.split(",")[4] for line in found[:4]] == [
        "copy paper",
        "aluminum foil",
        "polypropylene",
        "typing paper",
    ]


def test_the_terminal_ends_with_matrices_tests_and_the_report(okamoto: Analysis) -> None:
    lines = okamoto.text(full=True).split("\n")
    assert lines[0] == LABELS["RECONSTRUCTION"]
    assert lines[-2] == f"Report: {okamoto.report}"
    assert all(len(line) <= 100 for line in lines[:-2])
    wanted = (
        "Planned and done",
        "Comparison with the paper",
        "Answer ratios",
        "Tests against chance",
        "Questions and answers",
    )
    order = [lines.index(title) for title in wanted]
    assert order == sorted(order)
    assert any(line.startswith("copy paper     0.787 ± 0.239***") for line in lines)
    assert any(line.startswith("copy paper     0.970 ± 0.067***") for line in lines)


@pytest.mark.parametrize(("width", "most"), [(40, 70), (80, 40), (100, 40)])
def test_a_terminal_has_the_answers_the_path_and_the_next_command_in_its_width(
    okamoto: Analysis, width: int, most: int
) -> None:
    *lines, path, following = okamoto.text(width).split("\n")
    assert path == f"Report: {okamoto.report}"
    assert following == f"Next: palpate audit {okamoto.datasets[0]}"
    assert max(map(len, lines)) <= width
    assert len(lines) + 2 <= most
    titles = [above for above, rule in pairwise(lines) if rule and set(rule) == {"="}]
    assert titles == ["Questions and answers"]
    assert " ".join(lines).count("RECONSTRUCTION") == 1


def test_each_published_question_has_one_answer_with_what_weakens_it(okamoto: Analysis) -> None:
    """t of the real task and sign flips agree; both analyses of variance take ratios as independent."""
    first = okamoto.sections[0]
    assert [(one.standing, len(one.warnings)) for one in first.asked] == [
        ("published; companion test", 1), ("published test", 1), ("published test", 1), ("published test", 1),
    ]  # fmt: skip
    answers = [one.answer for one in first.asked]
    numbers = ("n = 15", "n = 10", "95 % CI 0.64"), ("2.12", "n = 15"), ("7.49", "n = 10"), ("0.968", "25", "0.550")
    assert all(number in said for of, said in zip(numbers, answers, strict=True) for number in of)
    assert "10 differ" in first.paragraphs[-1]


def test_a_reconstruction_gives_nothing_that_joins_rows_of_a_participant(okamoto: Analysis) -> None:
    """Printed tables do not say which rows are of one person; the same data of participants give all of it."""
    found = okamoto.results
    assert (found.beside.materials, found.beside.both, found.beside.paired, found.beside.logit) == ({}, (), (), None)
    assert list(found.beside.statements.values()) == [LINKED]
    for one in found.identifications:
        assert one.statements == {"joined": LINKED}
        assert one.information
        assert one.jackknife is None
        assert one.choice
        assert one.choice.misfit
        assert one.choice.similarities is one.choice.biases is None
        assert one.detection
        assert (one.detection.interval, one.detection.by_participant) == (None, {})
        assert one.lapses
        assert {one.lapses.lapse, *one.lapses.lapses, *one.lapses.biases} == {None}
    forms = {form.shrout_fleiss for one in found.reliabilities if one.icc for form in one.icc.forms}
    assert forms == {"ICC(1,1)", "ICC(1,k)"}
    assert not [path for path in okamoto.files if path.name.startswith("participants-")]
    report = okamoto.report.read_text("utf-8")
    assert report.count(LINKED) == 5
    (paper,) = re.findall(r'</h1><p class="source">(.*?)</p>', report)
    assert "(2012)" in paper


def test_the_report_has_3500_words_at_most(okamoto: Analysis) -> None:
    text = re.sub(r"<style>.*?</style>|<svg .*?</svg>", " ", okamoto.report.read_text("utf-8"), flags=re.DOTALL)
    assert len(re.sub(r"<[^>]+>", " ", text).split()) <= 3500


def test_every_table_says_whether_it_was_planned_published_ours_or_exploratory(okamoto: Analysis) -> None:
    """The paper prints Tables 1 and 2, t, both ANOVAs and an ICC; the one-way ANOVA of Task 2 is not in it."""
    marks = {(part.slug, table.title): table.standing for part in okamoto.sections for table in part.tables}
    words = {"published", "companion", "exploratory", "descriptive"}
    assert all(mark and set(mark.split(", ")) <= words for mark in marks.values())
    by_slug = {slug: {mark for (of, _), mark in marks.items() if of == slug} for slug, _ in marks}
    published = ("found", "confusion", "tests", "icc")
    assert {slug: by_slug[slug] for slug in published} == {slug: {"published"} for slug in published}
    assert by_slug["intervals"] == {"companion"}
    assert by_slug["confusions"] == {"exploratory"}
    one_way = {title.split(":")[0]: mark for (_, title), mark in marks.items() if title.startswith("One-way")}
    assert one_way == {"One-way, virtual": "published", "One-way, real": "exploratory"}
    report = okamoto.report.read_text(encoding="utf-8")
    report += (okamoto.out / "methods.html").read_text(encoding="utf-8")
    assert report.count('<span class="standing">') >= len(marks)


def test_what_was_left_out_is_never_passed_over(tmp_path: Path) -> None:
    sessions = {str(k): {"virtual": balanced(k)} for k in range(1, 5)}
    found = analyse([write_dataset(tmp_path, sessions, withdrawn=["4"])], figures=False)
    assert "12 of 48 attempts" in " ".join(found.text().split())


def _floats(value: Any) -> Iterator[float]:
    if isinstance(value, float):
        yield value
    elif isinstance(value, dict):
        for item in value.values():
            yield from _floats(item)
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _floats(item)


def test_the_dictionary_is_json_without_nan(okamoto: Analysis) -> None:
    document = okamoto.as_dict()
    assert json.loads(json.dumps(document, allow_nan=False)) is not None
    assert document["report"] == str(okamoto.report)
    stored = json.loads((okamoto.out / "results.json").read_text())
    assert stored["tasks"][0]["mean"][0][0] == pytest.approx(0.7867, abs=5e-5)
    assert Draft202012Validator(json.loads(formats.RESULTS.read_text("utf-8"))).is_valid(stored)
    assert "out" not in stored


def test_every_file_carries_the_label(okamoto: Analysis) -> None:
    label = LABELS["RECONSTRUCTION"]
    written = {str(path.relative_to(okamoto.out)) for path in okamoto.files}
    assert {"figures/confusion.png", "figures/correct-ratios.svg", "tables/tests.csv", "report.html"} <= written
    for path in sorted(path for path in okamoto.out.rglob("*") if path.is_file()):
        assert label.encode() in path.read_bytes(), path


class _Links(HTMLParser):
    """Collects what an HTML page would load, and checks that its tags close."""

    VOID = ("meta", "br", "link", "img", "use", "path", "rect", "stop", "hr")

    def __init__(self) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.ids: list[str] = []
        self.targets: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        self.handle_startendtag(tag, attrs)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("src", "href", "xlink:href", "data", "action") and value is not None:
                (self.targets if value.startswith("#") else self.loads).append(value)
            elif name == "id" and value is not None:
                self.ids.append(value)
        assert tag not in ("script", "link", "iframe", "object")

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open.pop() == tag


def test_the_report_needs_nothing_else(okamoto: Analysis) -> None:
    page = _Links()
    text = okamoto.report.read_text(encoding="utf-8")
    page.feed(text)
    assert page.open == []
    assert page.loads == ["methods.html"]
    assert {target.removeprefix("#") for target in page.targets} <= set(page.ids)
    assert not re.search(r"@import|url\((?!#)", text)
    assert text.count("<svg ") == sum(path.suffix == ".svg" for path in okamoto.files) == 4


def test_the_report_states_label_exclusions_and_formulas(okamoto: Analysis) -> None:
    text = okamoto.report.read_text(encoding="utf-8")
    body = text[text.index("<body>") :]
    assert body.startswith(f'<body><div class="band" role="note">{LABELS["RECONSTRUCTION"]}')
    assert "1,000 attempts" in body
    body = (okamoto.out / "methods.html").read_text(encoding="utf-8")
    for name in ("Holm", "Henderson", "ICC(A,1)", "Type III", "Cohen", "seeded with [1, index of the task"):
        assert name in body


def test_a_second_run_gives_the_same_bytes(repository_root: Path, okamoto: Analysis) -> None:
    before = {path: path.read_bytes() for path in okamoto.files}
    analyse([repository_root / "participants" / "okamoto2012"], okamoto.out)
    assert {path: path.read_bytes() for path in okamoto.files} == before


def test_without_figures_earlier_figures_go(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "data", {"1": {"real": balanced(1)}, "2": {"real": balanced(2)}})
    first = analyse([root])
    assert first.out == root / "derivatives" / "palpate"
    second = analyse([root], figures=False)
    assert not list(second.out.glob("figures/*"))
    assert "<svg" not in second.report.read_text()


def test_results_never_stand_among_the_data(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "data", {"1": {"real": balanced(1)}, "2": {"real": balanced(2)}})
    for out in (root, root / "sub-1", root / "sourcedata", root / "derivatives"):
        with pytest.raises(DatasetError) as error:
            analyse([root], out, figures=False)
        assert error.value.finding.where == f"--out {out}"
    assert not (root / "derivatives").exists()


def _no_nan(found: Analysis) -> str:
    assert json.dumps(found.as_dict(), allow_nan=False)
    shown = found.text(full=True)
    assert all(len(line) <= 100 for line in shown.split("\n")[:-2])
    texts = [path.read_text(encoding="utf-8") for path in found.files if path.suffix not in (".svg", ".png")]
    for text in (shown, *texts):
        body = re.sub(r"<style>.*?</style>|<svg .*?</svg>", "", text, flags=re.DOTALL)
        assert not re.search(r"\b(nan|NaN|NAN|inf|Infinity|None)\b", body)
    return shown


def _sentences(found: Analysis) -> list[str]:
    return [line for one in found.sections for line in (*one.paragraphs, *(n for t in one.tables for n in t.notes))]


def _unusual(found: Analysis, usual: Analysis) -> list[str]:
    """Return the sentences of a report that the report of a usual study does not have."""
    return [line for line in _sentences(found) if line not in _sentences(usual)]


def test_one_task(tmp_path: Path, okamoto: Analysis, approved: SnapshotAssertion) -> None:
    sessions = {str(k): {"virtual": balanced(k)} for k in range(1, 5)}
    found = analyse([write_dataset(tmp_path, sessions)], pictures=False)
    shown = _no_nan(found)
    assert _unusual(found, okamoto) == approved
    assert "Comparison with the paper" not in shown


def test_one_participant(tmp_path: Path, okamoto: Analysis, approved: SnapshotAssertion) -> None:
    found = analyse([write_dataset(tmp_path, {"1": {"virtual": balanced(1), "real": balanced(2)}})], pictures=False)
    _no_nan(found)
    assert _unusual(found, okamoto) == approved


def test_constant_answers(tmp_path: Path, okamoto: Analysis, approved: SnapshotAssertion) -> None:
    rows = trials([(material, MATERIALS[0]) for material in MATERIALS for _ in range(3)])
    sessions = {str(k): {"virtual": rows, "real": rows} for k in range(1, 4)}
    found = analyse([write_dataset(tmp_path, sessions)], pictures=False)
    _no_nan(found)
    assert _unusual(found, okamoto) == approved


def test_the_same_answer_to_everything_by_everyone(
    tmp_path: Path, okamoto: Analysis, approved: SnapshotAssertion
) -> None:
    rows = trials([(material, material) for material in MATERIALS for _ in range(3)])
    found = analyse([write_dataset(tmp_path, {str(k): {"real": rows} for k in range(1, 4)})], pictures=False)
    _no_nan(found)
    assert _unusual(found, okamoto) == approved


def test_unequal_numbers_missing_answers_and_missing_materials(
    tmp_path: Path, okamoto: Analysis, approved: SnapshotAssertion
) -> None:
    sessions = {str(k): {"virtual": balanced(k), "real": balanced(k + 1)} for k in range(1, 5)}
    sessions["5"] = {"virtual": trials([("sand", "sand"), ("sand", "(none)"), ("snow", "snow")])}
    found = analyse([write_dataset(tmp_path, sessions)], pictures=False)
    shown = _no_nan(found)
    assert _unusual(found, okamoto) == approved
    assert "(none)" in shown
    assert [r.icc.raters for r in found.results.reliabilities if r.icc] == [4, 4, 4, 4, 4]


def test_two_materials_with_long_names_and_many_exclusions(tmp_path: Path) -> None:
    names = ("a material whose name says much more than a name should ever say", "b")
    rows = [trial(k, names[k % 2], names[k % 3 % 2], attempt=2) for k in range(1, 31)]
    again = [trial(k, names[k % 2], "n/a", counted=False, redo_reason="slipped") for k in range(1, 31)]
    found = analyse(
        [write_dataset(tmp_path, {"1": {"real": again + rows}, "2": {"real": rows}}, materials=names)], pictures=False
    )
    shown = _no_nan(found)
    assert re.search(r"done again +30", shown)
    assert found.report.read_text().count("was repeated: slipped") == 30


def test_a_rehearsal_is_labelled_and_compared_in_its_own_words(
    tmp_path: Path, okamoto: Analysis, approved: SnapshotAssertion
) -> None:
    sessions = {
        str(k): {"virtual": balanced(k, 10, OKAMOTO), "real": balanced(k + 1, 10, OKAMOTO)} for k in range(1, 5)
    }
    root = write_dataset(tmp_path, sessions, study="okamoto2012", origin="REHEARSAL", materials=OKAMOTO)
    found = analyse([root], pictures=False)
    shown = _no_nan(found)
    assert shown.startswith("REHEARSAL - simulated participants")
    assert _unusual(found, okamoto) == approved
    assert "agrees" not in shown


def test_nothing_left_is_an_error_with_the_reason(tmp_path: Path, refuses: Refuses) -> None:
    root = write_dataset(tmp_path, {"1": {"real": balanced(1)}}, withdrawn=["1"])
    with refuses(DatasetError):
        analyse([root])


def test_of_one_everything_is_said_in_the_singular(tmp_path: Path) -> None:
    found = analyse([write_dataset(tmp_path, {"1": {"real": [trial(1, "sand", "snow")]}})], figures=False)
    said = " ".join((found.text(full=True) + found.report.read_text()).split())
    assert re.findall(r"\b1 (?:\w+ )?(?:participants|trials|answers|times|rows)\b", said) == []
    assert "1 participant in" in said


def test_markup_in_a_dataset_stays_text(tmp_path: Path) -> None:
    names = ("<script>alert(1)</script>", "snow & ice")
    found = analyse([write_dataset(tmp_path, {"1": {"real": balanced(1, 4, names)}}, materials=names)], pictures=False)
    page = _Links()
    page.feed(found.report.read_text())
    assert page.loads == ["methods.html"]


def test_the_analysis_loads_no_oracle_and_prints_nothing(tmp_path: Path) -> None:
    root = write_dataset(tmp_path, {"1": {"real": balanced(1)}, "2": {"real": balanced(2)}})
    code = (
        "import sys; from pathlib import Path; from palpate.analysis.analyse import analyse\n"
        f"analyse([Path({str(root)!r})], figures=False)\n"
        "heavy = {'statsmodels', 'scipy.stats', 'matplotlib', 'psychopy', 'serial', 'palpate.experiment.session'}\n"
        "sys.exit(sorted(heavy & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_a_material_that_was_never_presented(tmp_path: Path, okamoto: Analysis, approved: SnapshotAssertion) -> None:
    sessions = {str(k): {"virtual": balanced(k, 4, MATERIALS[:2])} for k in range(1, 4)}
    found = analyse([write_dataset(tmp_path, sessions)], pictures=False)
    _no_nan(found)
    assert _unusual(found, okamoto) == approved
