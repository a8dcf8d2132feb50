"""The audit of files that analysts write: scores, ANOVA tables, and what is refused."""

from __future__ import annotations

import statistics
from pathlib import Path

import pytest
from scipy import stats
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.audit import evidence, print_lines
from palpate.analysis.audit.audit import audit
from palpate.analysis.audit.mistakes import Line
from palpate.analysis.audit.print_lines import UNDECIDED
from palpate.analysis.published.paper import Stated
from palpate.experiment.errors import PublishedError
from tests.approved import Refuses

SCORES = """
study = "scores"
source = "Somebody"

[[task]]
id = "all"
participants = 28

[[score]]
where = "Table 1"
task = "all"
items = 1
cells = [
  { name = "ease", mean = "5.19", sd = "1.60" },
  { name = "joy", mean = "5.21", sd = "1.60" },
]

[[t]]
where = "Text"
tests = [
  { task = "all", of = "joy", df = 27, t = "4.03", p = "<0.001", null = "4" },
  { task = "all", of = "fear", df = 27, t = "2.05", p = "0.02", null = "4" },
]

[[anova]]
where = "Table 2"
lines = [
  { name = "groups", ss = "20.0", df = 2, ms = "10.0", f = "5.00", p = "0.026" },
  { name = "error", ss = "24.0", df = 12, ms = "2.4" },
]
"""


@pytest.fixture
def scores(tmp_path: Path) -> Path:
    file = tmp_path / "scores.toml"
    file.write_text(SCORES, encoding="utf-8")
    return file


def test_scores_tests_and_anova_tables_of_any_study(scores: Path) -> None:
    """By hand: 5.19 of 28 is the opening example of Brown and Heathers 2017. 5.21 is 146 / 28, so that 1.60 leaves the
    sum of squares 830 alone: variance (830 - 146^2 / 28) / 27 = 2.545, t = (146 / 28 - 4) sqrt(28 / 2.545) = 4.03.
    24 / 12 is 2, not 2.4, and 10 / 2.4 is 4.2.
    """
    found = audit(str(scores))
    verdicts = {(line.subject, line.quantity): line.verdict for line in found.comparison.lines}
    assert verdicts == {
        ("ease", "mean"): "impossible",
        ("ease", "SD"): "cannot be decided",
        ("joy", "mean"): "agrees",
        ("joy", "SD"): "agrees",
        ("joy", "t(27)"): "agrees",
        ("joy", "P"): "agrees",
        ("joy", "df"): "agrees",
        ("fear", "t(27)"): "cannot be decided",
        ("fear", "P"): "differs",
        ("fear", "df"): "agrees",
        ("groups", "MS"): "agrees",
        ("groups", "F"): "differs",
        ("groups", "P"): "agrees",
        ("error", "MS"): "differs",
    }


def test_p_of_a_lone_t_is_held_against_it(scores: Path, approved: SnapshotAssertion) -> None:
    (line,) = [one for one in audit(str(scores)).comparison.lines if (one.subject, one.quantity) == ("fear", "P")]
    # 2.05 stands for all from 2.045, rounded, to below 2.06, truncated.
    assert line.low == pytest.approx(2 * stats.t.sf(2.06, 27), rel=1e-6)
    assert line.high == pytest.approx(2 * stats.t.sf(2.045, 27), rel=1e-6)
    assert line.reason == approved


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("okamoto1999", "got no study, file or folder; allowed: okamoto2012, wellman1995, or a path"),
        ("nowhere.toml", "no such file"),
    ],
)
def test_what_cannot_be_audited_is_refused(target: str, message: str) -> None:
    with pytest.raises(PublishedError, match=message):
        audit(target)


def test_a_file_is_refused_with_every_problem_at_once(scores: Path) -> None:
    text = scores.read_text(encoding="utf-8")
    changes = [('"5.19"', "5.19"), ('task = "all"', 'task = "a"'), ('null = "4"', 'nulll = "4"'), ('"1.60"', '"-1"')]
    for old, new in changes:
        text = text.replace(old, new, 1)
    scores.write_text(text, encoding="utf-8")
    with pytest.raises(PublishedError) as caught:
        audit(str(scores))
    for problem in (
        "mean: got 5.19; allowed: a number as printed, in quotes",
        "score[0].task: got 'a'; allowed: one of: all",
        "no such key; did you mean 'null'?",
        "sd: got '-1'; allowed: a number as printed, not negative",
        "null: got nothing; allowed: a number, if the file states no chance",
    ):
        assert problem in str(caught.value)


def test_stars_need_their_levels(scores: Path, refuses: Refuses) -> None:
    text = scores.read_text(encoding="utf-8").replace('sd = "1.60" }', 'sd = "1.60", stars = "*" }', 1)
    scores.write_text(text, encoding="utf-8")
    with refuses(PublishedError):
        audit(str(scores))


LOW = (*[1] * 9, *[2] * 11, *[3] * 6, *[4] * 2)
"""28 answers on a scale from 1 to 7: mean 2.04, t(27) = -11.3 against 4, P = 1e-11."""


def _stars_of(tmp_path: Path, level: str, marks: str, *, tested: bool = True) -> Line:
    t = stats.ttest_1samp(LOW, 4).statistic
    test = f'{{ task = "all", of = "ease", df = 27, t = "{t:.2f}", p = "<0.001", null = "4" }}'
    file = tmp_path / "low.toml"
    file.write_text(
        'study = "low"\nsource = "We"\nchance = "0.25"\n[[task]]\nid = "all"\nparticipants = 28\n'
        f'[[levels]]\nstars = "*"\np = "0.05"\n{level}\n[[score]]\nwhere = "Table"\ntask = "all"\nitems = 1\n'
        f'cells = [{{ name = "ease", mean = "{statistics.mean(LOW):.2f}", sd = "{statistics.stdev(LOW):.2f}", '
        f'stars = "{marks}" }}, {{ name = "joy", mean = "5.21", sd = "1.60", stars = "*" }}]\n'
        + (f'[[t]]\nwhere = "Text"\ntests = [{test}]\n' if tested else "")
    )
    lines = audit(str(file)).comparison.lines
    assert [line.verdict for line in lines if line.subject == "joy" and line.quantity == "stars"] == [UNDECIDED]
    (line,) = [line for line in lines if line.subject == "ease" and line.quantity == "stars"]
    return line


@pytest.mark.parametrize(
    ("level", "marks", "found", "verdict"),
    [
        ("", "*", "*", "agrees"),
        ("above = false", "*", "*", "agrees"),
        ("", "", "*", "differs"),
        ("above = true", "*", "none", "differs"),
        ("above = true", "", "none", "agrees"),
    ],
)
def test_stars_below_the_null(tmp_path: Path, level: str, marks: str, found: str, verdict: str) -> None:
    """Oracle: scipy's t of the answers. Whether a mean below the null earns stars is the study's own convention."""
    assert stats.ttest_1samp(LOW, 4).pvalue < 1e-10
    line = _stars_of(tmp_path, level, marks)
    assert (line.recomputed, line.verdict) == (found, verdict)


def test_a_score_without_a_test_is_not_held_against_the_chance_of_ratios(
    tmp_path: Path, approved: SnapshotAssertion
) -> None:
    line = _stars_of(tmp_path, "", "*", tested=False)
    assert line.verdict == UNDECIDED
    assert line.reason == approved


def test_a_test_of_a_score_needs_its_null(scores: Path, refuses: Refuses) -> None:
    text = scores.read_text(encoding="utf-8").replace('source = "Somebody"', 'source = "Somebody"\nchance = "0.25"')
    scores.write_text(text.replace(', null = "4"', ""), encoding="utf-8")
    with refuses(PublishedError):
        audit(str(scores))


def test_a_score_may_not_have_the_name_of_a_material(scores: Path, refuses: Refuses) -> None:
    """A test of "ease" would be of both, and hypothesis found a file in which the one was checked as the other."""
    cell = '{ presented = "ease", answered = "ease", mean = "0.5" }'
    table = f'[[table]]\nwhere = "T"\ntask = "all"\ncomplete = false\ncells = [{cell}]\n'
    scores.write_text(scores.read_text(encoding="utf-8") + table, encoding="utf-8")
    with refuses(PublishedError):
        audit(str(scores))


def test_against_is_for_datasets(scores: Path) -> None:
    with pytest.raises(PublishedError, match="not a dataset"):
        audit("okamoto2012", scores)


def test_more_entries_than_a_study_has_are_refused(scores: Path, refuses: Refuses) -> None:
    text = scores.read_text(encoding="utf-8")
    more = "".join(f'  {{ name = "n{k}", mean = "5.21" }},\n' for k in range(1000))
    scores.write_text(text.replace("cells = [\n", f"cells = [\n{more}", 1), encoding="utf-8")
    with refuses(PublishedError):
        audit(str(scores))


def test_an_anova_table_of_more_lines_than_can_be_tried_is_refused(scores: Path) -> None:
    text = scores.read_text(encoding="utf-8")
    more = "".join(f'  {{ name = "n{k}", df = 1 }},\n' for k in range(49))
    scores.write_text(text.replace("lines = [\n", f"lines = [\n{more}", 1), encoding="utf-8")
    with pytest.raises(PublishedError, match="at most 50 lines"):
        audit(str(scores))


def test_numbers_that_take_too_much_work_are_refused(
    scores: Path, monkeypatch: pytest.MonkeyPatch, refuses: Refuses
) -> None:
    monkeypatch.setattr(evidence, "MOST_WORK", 3)
    with refuses(PublishedError):
        audit(str(scores))


def test_rows_beyond_their_work_are_left_undecided(
    monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
) -> None:
    """But for one, whose means cannot add up, for which no work is needed."""
    monkeypatch.setattr(print_lines, "MOST_COLUMNS", 0)
    rows = [line for line in audit("okamoto2012").comparison.lines if line.quantity == "row"]
    (impossible,) = [line for line in rows if line.verdict != UNDECIDED]
    assert impossible.subject == "row of polypropylene"
    assert {line.reason for line in rows if line is not impossible} == approved


def test_a_table_whose_caption_is_its_task_is_named_once(tmp_path: Path) -> None:
    file = tmp_path / "paper.csv"
    file.write_text("Task 1\n,a,b,c\na,8,1,1\nb,2,7,1\nc,0,2,8\n", encoding="utf-8")
    text = audit(str(file), None, Stated((5,))).text(80)
    assert "\nTask 1\n" in text
    assert "task 1" not in text
