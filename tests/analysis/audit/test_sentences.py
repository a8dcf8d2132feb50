"""Tests in sentences are read in every style, and their P recomputed; expected values are those of R 4.2.2."""

from __future__ import annotations

import math
import random
from pathlib import Path

import pytest
from scipy import stats

from palpate.analysis.audit.audit import audit
from palpate.analysis.audit.sentences import p_values, sentence_lines
from palpate.analysis.published.paper import Stated, read
from palpate.analysis.published.prose import MOST_TESTS, mentions_one_tailed, reported_tests, words
from palpate.experiment.errors import PublishedError


@pytest.mark.parametrize(
    ("sentence", "statistic", "df", "p"),
    [
        # 2*pt(-2.2, 28), pf(4.5, 2, 27, lower=F), pchisq(6.4, 2, lower=F), r = 0.45 as t(28), 2*pnorm(-1.96)
        ("t(28) = 2.20, p = .036", "t", ("28",), 0.036225),
        ("t (28)=2,20; p = 0,036", "t", ("28",), 0.036225),
        ("$t_{28} = 2.20$, $P = .036$", "t", ("28",), 0.036225),
        ("t(28) = \u22122.20 (p = .036)", "t", ("28",), 0.036225),
        ("F(2, 27) = 4.50, MSE = 3.2, p = .021, \u03b7\u00b2 = .25", "F", ("2", "27"), 0.020574),
        ("F(2,27)=4.50,p=.021", "F", ("2", "27"), 0.020574),
        ("\u03c7\u00b2(2, N = 90) = 6.40, p = .041", "chi2", ("2",), 0.040762),
        ("chi-squared(2) = 6.40, p = .041", "chi2", ("2",), 0.040762),
        ("r(28) = .45, p = .013", "r", ("28",), 0.012591),
        ("z = 1.96, p = .05", "z", (), 0.049996),
        ("Z = 1.96, P < 0.051", "z", (), 0.049996),
        # The same of -1.96 with 1100 df, and of 4.35 with 2 and 1100, and 1 and 100.
        ("t(1,100) = 1.96, p = .05", "t", ("1100",), 0.050248),
        ("F(2, 1,100) = 4.35, p = .013", "F", ("2", "1100"), 0.013130),
        ("F(1,100) = 4.35, p = .04", "F", ("1", "100"), 0.039555),
        ("t(28) = 2.20, p < 5 %", "t", ("28",), 0.036225),
        ("p = .036 for t(28) = 2.20", "t", ("28",), 0.036225),
        ("p = .021 for the effect of task, F(2, 27) = 4.50", "F", ("2", "27"), 0.020574),
        ("(p = .050; z = 1.96)", "z", (), 0.049996),
        ("t = 2.20, df = 28, p = .036", "t", ("28",), 0.036225),
        ("F = 4.50, df = 2, 27, p = .021", "F", ("2", "27"), 0.020574),
        ("\u03c7\u00b2 = 6.40 (df = 2), p = .041", "chi2", ("2",), 0.040762),
        ("\u03c7\u00b2\u2082 = 6.40, p = .041", "chi2", ("2",), 0.040762),
        ("Chi-Quadrat(2) = 6,40; p = ,041", "chi2", ("2",), 0.040762),
        ("r = .45, n = 30, p = .013", "r", ("28",), 0.012591),
        # By R, the upper tail of F = 4.1 with 1.62 and 17.8 df.
        ("F(1,62, 17,8) = 4,10, p = 0,042", "F", ("1.62", "17.8"), 0.041463),
        ("F(1,62; 17,8) = 4,10; p = 0,042", "F", ("1.62", "17.8"), 0.041463),
        ("t(28) = 2.20, p = 3.62 \u00d7 10\u22122", "t", ("28",), 0.036225),
    ],
)
def test_a_test_is_read_however_it_is_written(sentence: str, statistic: str, df: tuple[str, ...], p: float) -> None:
    (one,) = reported_tests(f"We saw that {sentence}, as was expected.").tests
    assert (one.statistic, tuple(each.text for each in one.df)) == (statistic, df)
    assert float(p_values(one).low) <= p <= float(p_values(one).high)
    (line,) = sentence_lines([one], one_tailed=False)
    assert line.agrees


@pytest.mark.parametrize(
    ("sentence", "p"),
    [
        ("(p = .03, t(11) = 2.49; p = .50, t(11) = 0.70)", {"t(11) = 2.49": "0.03", "t(11) = 0.70": "0.50"}),
        (
            "p = .001 for F(1, 11) = 18.2, p = .62 for F(1, 11) = 0.26",
            {"F(1, 11) = 18.2": "0.001", "F(1, 11) = 0.26": "0.62"},
        ),
        ("t(11) = 2.49, p = .03, t(11) = 0.70, p = .50", {"t(11) = 2.49": "0.03", "t(11) = 0.70": "0.50"}),
        ("at p < .05 (t(11) = 2.49, p = .03; t(11) = 0.70, p = .50)", {"t(11) = 2.49": "0.03", "t(11) = 0.70": "0.50"}),
        ("p < .05 (t(11) = 2.49, p = .03, r = .60)", {"t(11) = 2.49": "0.03"}),
        ("p = .03, t(11) = 2.49, p = .50", {}),
        ("p = .03, t = 2.49, df = 11; p = .50, t = 0.70, df = 11", {}),
    ],
)
def test_of_tests_in_a_row_each_has_its_own_p(sentence: str, p: dict[str, str]) -> None:
    made = reported_tests(f"We saw {sentence}.")
    assert {one.head: one.p.text for one in made.tests} == p
    printed = [number for number in ("= .03", "= .50") if number in sentence]
    assert p or all(any(number in line for line in made.unchecked) for number in printed)


def test_a_page_with_subscripts_entities_and_scripts() -> None:
    page = (
        "<p><i>t</i><sub>11</sub>&nbsp;= 8.14, <i>p</i>&nbsp;&lt;&nbsp;.001;</p><script>t(3) = 1.0, p = .9</script>"
        "<p><em>F</em>(1, 20) = 15.00, <em>p</em> = 9.5 \u00d7 10<sup>\u22124</sup></p>"
    )
    assert [(one.statistic, one.p.text) for one in reported_tests(words(page)).tests] == [
        ("t", "<0.001"),
        ("F", "9.5e-4"),
    ]


@pytest.mark.parametrize(
    ("sentence", "quantity"),
    [
        ("t(28) = 2.20, p = .36", "P"),
        ("t(28) = 2.20, p > .05", "P"),
        ("t(28) = 2.20, ns", "P"),
        ("F(2, 27) = 4.50, p < .01", "P"),
        ("r(28) = 1.45, p = .01", "r"),
        ("F(2, 27) = -4.50, p = .021", "F"),
        ("\u03c7\u00b2(2) = -6.40, p = .041", "chi2"),
        ("t(28) = 2.20, p = 1.5", "P"),
        ("t(28) = 2.20, p = 3.6 %, and t(28) = 2.20, p = 36 %", "P"),
        ("t(28) = 2.20, 95% CI [-0.2, 2.0], p = .036", "95% CI"),
        ("t(28) = 2.20, p = .018", "P"),
    ],
)
def test_what_contradicts_itself_is_accused(sentence: str, quantity: str) -> None:
    lines = [*sentence_lines(reported_tests(sentence).tests, one_tailed=False)]
    assert [line.quantity for line in lines if not line.agrees] == [quantity]


@pytest.mark.parametrize(
    ("sentence", "named"),
    [
        ("U = 30.5, p = .9", ["U = 30.5, p = .9"]),
        ("H(2) = 9.21, p = .01, and \u03b2 = 0.34, p = .02", ["H(2) = 9.21, p = .01", "\u03b2 = 0.34, p = .02"]),
        ("It was so, t(11) = 2.24. Others had more, p = .02", ["t(11) = 2.24", "p = .02"]),
        ("t = 2.24, p = .05", ["t = 2.24, p = .05"]),
        ("M = 3.4, 95% CI [0.1, 0.9]", ["95% CI [0.1, 0.9]"]),
        ("t(0) = 2.24, p = .05", ["t(0) = 2.24, p = .05"]),
        ("t(28) = 2.20, p = .036, at t = 0.5 s and z = 3 mm", []),
    ],
)
def test_what_looks_like_a_test_and_is_not_read_is_named(sentence: str, named: list[str]) -> None:
    assert [each.split("'")[1] for each in reported_tests(sentence).unchecked] == named


@pytest.mark.parametrize(
    ("text", "whether"),
    [
        ("All tests were one-sided.", True),
        ("We had directional hypotheses.", True),
        ("The transfer is bidirectional (bi-directional tests).", False),
        ("Non-directional tests, and a directional microphone.", False),
    ],
    ids=["sided", "directional", "bidirectional", "microphone"],
)
def test_a_direction_of_something_else_makes_no_test_one_tailed(text: str, whether: bool) -> None:
    assert mentions_one_tailed(text) is whether


def test_half_a_p_stands_where_the_paper_says_one_tailed() -> None:
    text = "All tests are one-tailed. t(28) = 2.20, p = .018"
    assert mentions_one_tailed(text)
    assert all(line.agrees for line in sentence_lines(reported_tests(text).tests, one_tailed=True))


def test_no_right_line_is_accused() -> None:
    """Statistics are drawn, and printed as a paper does: P by scipy of the unrounded value."""
    draw = random.Random(5)
    made = []
    for _ in range(300):
        df, value = draw.randint(3, 200), draw.uniform(0.05, 6)
        r, above = draw.uniform(-0.9, 0.9), draw.randint(1, 5)
        for head, p in (
            (f"t({df}) = {value:.2f}", 2 * stats.t.sf(value, df)),
            (f"F({above}, {df}) = {value:.2f}", stats.f.sf(value, above, df)),
            (f"\u03c72({above}) = {value:.2f}", stats.chi2.sf(value, above)),
            (f"z = {value:.2f}", 2 * stats.norm.sf(value)),
            (f"r({df}) = {r:.2f}", 2 * stats.t.sf(abs(r) * math.sqrt(df / (1 - r * r)), df)),
        ):
            shown = "p < .001" if p < 0.001 else f"p = {p:.3f}" if draw.random() < 0.5 else f"p = {p:.2f}"
            made.append(f"{head}, {shown}")
    lines = [*sentence_lines(reported_tests(". ".join(made)).tests, one_tailed=False)]
    assert len(lines) == len(made) == 1500
    assert [line for line in lines if not line.agrees] == []


def test_of_more_tests_than_are_read_the_first_are_and_the_others_told(tmp_path: Path) -> None:
    paper = tmp_path / "paper.txt"
    paper.write_text("z = 1.96, p = .05. " + "t(28) = 2.20, p = .036. " * MOST_TESTS)
    found = read(paper, Stated())
    assert (len(found.tests), found.tests[0].statistic, len(found.passed_over)) == (MOST_TESTS, "z", 1)


def test_an_audit_of_a_text_and_of_one_that_says_nothing(tmp_path: Path) -> None:
    paper = tmp_path / "paper.txt"
    paper.write_text("We saw t(28) = 2.20, p = .36.\n")
    found = audit(str(paper))
    assert [(line.subject, line.verdict) for line in found.comparison.lines] == [("t(28) = 2.20", "differs")]
    for name, content in (
        ("nothing.txt", "No test.\n"),
        ("words.csv", "a;b\nx;y\n"),
        ("letters.csv", "Effect;SS;df;MS;F;p\nMaterial;a;b;c;d;e\nResidual;a;b;c;;\n"),
        ("paper.pdf", "%PDF-1.4\n"),
    ):
        (tmp_path / name).write_text(content)
        with pytest.raises(PublishedError) as refused:
            audit(str(tmp_path / name))
        assert refused.value.exit_code == 2
