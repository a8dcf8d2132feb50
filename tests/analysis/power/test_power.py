"""Power: against closed forms and exact enumeration, the same for any number of jobs; what is said of edge cases."""

from __future__ import annotations

import itertools
import json
import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats
from statsmodels.stats.power import TTestPower
from statsmodels.stats.proportion import proportion_confint
from syrupy.assertion import SnapshotAssertion

from palpate.analysis import designs
from palpate.analysis.power import planned_tests, report, simulate
from palpate.analysis.power.choice_models import Answers, ChoiceModel, fitted
from palpate.analysis.power.planned_tests import FLIPS, Model
from palpate.analysis.power.simulate import Chunk, Power
from palpate.analysis.statistics.inference import t_against_chance
from palpate.experiment.dataset.bids import LABELS
from palpate.experiment.errors import DatasetError, PowerError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import PlannedTest, Protocol
from tests.approved import Refuses

SLUGS = ("model", "needed", "power", "control", "estimates", "undefined")
HERE = partial(simulate.on_cores, jobs=1)


def protocol(
    *tests: PlannedTest, materials: int = 4, repetitions: int = 10, people: tuple[int, ...] = (15, 10)
) -> Protocol:
    """The footstep study with other numbers; all of its own tests by default."""
    own = files.load(shipped("okamoto2012.toml"))
    tasks = tuple(
        task.model_copy(update={"repetitions": repetitions, "participants": count})
        for task, count in zip(own.tasks, people, strict=False)
    )
    return own.model_copy(
        update={
            "tasks": tasks,
            "study": own.study.model_copy(update={"participants": people[0]}),
            "materials": own.materials[:materials],
            "analysis": tests or own.analysis,
        }
    )


def t_test(chance: float, alpha: float = 0.05) -> PlannedTest:
    return PlannedTest(test="t against chance", tasks=("virtual",), question="?", chance=chance, alpha=alpha)


def two_answers(p: float, spread: float) -> ChoiceModel:
    """Two materials, each answered correctly with probability `p` on average."""
    return ChoiceModel("test", (Answers("virtual", np.array([[p, 1 - p, 0], [1 - p, p, 0]]), np.full(2, spread)),))


def run(study: Protocol, model: Model, **changed: Any) -> Power:
    asked: dict[str, Any] = {"participants": (6,), "studies": 300, "seed": 1, "target": 0.8, "runner": HERE} | changed
    return simulate.run(study, planned_tests.design(study, {}), model, **asked)


def guess(study: Protocol) -> Model:
    from palpate.analysis.power.simulate import find

    return find("okamoto2012", study)


@pytest.fixture
def _no_flips(monkeypatch: pytest.MonkeyPatch) -> None:
    """The sign flips beside each t-test, which take most of the time, are left out: they have tests of their own."""
    monkeypatch.setattr(planned_tests, "sign_flip_tests", lambda counts, *_: np.ones(counts.shape[:-1]))


@pytest.mark.usefixtures("_no_flips")
def test_power_of_nearly_normal_ratios_is_that_of_the_noncentral_t() -> None:
    """statsmodels TTestPower. Ratios of 400 trials around one half, participants 0.1 apart: close to normal."""
    rho, trials, chance = 0.04, 400, 0.45
    study = protocol(t_test(chance), materials=2, repetitions=trials, people=(12,))
    result = run(study, two_answers(0.5, rho), participants=(6, 12, 25), studies=20_000)
    sd = math.sqrt(0.25 * (rho + (1 - rho) / trials))
    for size in (6, 12, 25):
        expected = TTestPower().power((0.5 - chance) / sd, size, 0.05)
        for question in result.questions[:2]:
            row = result.row(question, size)
            assert row is not None
            assert row.power == pytest.approx(expected, abs=0.012)


def exact_power(
    people: int, trials: int, p: float, spread: float, chance: Fraction, alpha: float
) -> tuple[float, float]:
    """Probability that P lies below alpha, and that it is not defined: every outcome, with scipy's beta-binomial."""
    if spread:
        of_count = scipy.stats.betabinom(trials, p * (1 / spread - 1), (1 - p) * (1 / spread - 1))
    else:
        of_count = scipy.stats.binom(trials, p)
    weights = of_count.pmf(np.arange(trials + 1))
    significant = undefined = 0.0
    for counts in itertools.product(range(trials + 1), repeat=people):
        test = t_against_chance([Fraction(count, trials) for count in counts], chance)
        weight = math.prod(weights[count] for count in counts)
        undefined += weight * (test.p is None)
        significant += weight * (test.p is not None and test.p < alpha)
    return significant, undefined


@pytest.mark.parametrize(
    ("people", "trials", "p", "spread"), [(2, 3, 0.8, 0.0), (3, 2, 0.7, 0.3), (3, 4, 0.9, 0.1), (4, 2, 0.5, 0.6)]
)
def test_power_of_tiny_designs_is_that_of_every_outcome_counted(
    people: int, trials: int, p: float, spread: float
) -> None:
    alpha = 0.3
    study = protocol(t_test(0.5, alpha), materials=2, repetitions=trials, people=(people,))
    result = run(study, two_answers(p, spread), participants=(people,), studies=40_000, seed=11)
    for kind, at in (("model", p), ("guessing", 0.5)):
        significant, undefined = exact_power(people, trials, at, spread, Fraction(1, 2), alpha)
        for question in result.questions[:2]:
            row = result.row(question, people, kind)  # type: ignore[arg-type]
            assert row is not None
            assert row.power == pytest.approx(significant, abs=0.011)
            assert row.tally.undefined / row.tally.studies == pytest.approx(undefined, abs=0.011)


@pytest.mark.usefixtures("_no_flips")
def test_the_type_i_error_of_a_t_test_is_near_alpha() -> None:
    study = protocol(t_test(0.5), materials=2, repetitions=400, people=(12,))
    result = run(study, two_answers(0.6, 0.0), participants=(12,), studies=20_000)
    row = result.row(result.questions[0], 12, "guessing")
    assert row is not None
    assert row.interval is not None
    low, high = row.interval
    assert low <= 0.05 <= high


@pytest.mark.usefixtures("_no_flips")
def test_wilsons_interval_covers() -> None:
    """Over 200 seeds the 95 % interval holds the exact power about 95 times in 100."""
    study = protocol(t_test(0.5, 0.3), materials=2, repetitions=2, people=(3,))
    expected, _ = exact_power(3, 2, 0.7, 0.3, Fraction(1, 2), 0.3)
    held = 0
    for seed in range(200):
        result = run(study, two_answers(0.7, 0.3), participants=(3,), studies=400, seed=seed)
        row = result.row(result.questions[0], 3)
        assert row is not None
        assert row.interval is not None
        held += row.interval[0] <= expected <= row.interval[1]
    assert scipy.stats.binomtest(held, 200, 0.95).pvalue > 0.001


def document(result: Power) -> str:
    return json.dumps(report.as_dict(result), allow_nan=False)


def backwards(work: Any, chunks: Sequence[Chunk]) -> Iterator[tuple[int, Any]]:
    return ((place, work(chunks[place])) for place in reversed(range(len(chunks))))


def test_the_same_seed_gives_the_same_bytes_in_any_order_and_number_of_jobs() -> None:
    study = protocol()
    model = guess(study)
    asked = {"participants": (3, 5), "studies": 1500}
    first = document(run(study, model, **asked))
    assert document(run(study, model, **asked, runner=backwards)) == first
    assert document(run(study, model, **asked, runner=partial(simulate.on_cores, jobs=2))) == first
    assert document(run(study, model, **asked, seed=2)) != first


def _die(_: int) -> None:
    os._exit(1)


def test_a_process_that_is_killed_is_an_error_in_a_line(refuses: Refuses) -> None:
    with refuses(PowerError):
        list(simulate.on_cores(_die, [1, 2], jobs=2))


def test_power_at_a_size_does_not_depend_on_the_sizes_beside_it() -> None:
    study = protocol()
    model = guess(study)
    alone, beside = run(study, model), run(study, model, participants=(20, 6, 4, 6))
    assert beside.participants == (4, 6, 20)
    assert [row for row in beside.rows if row.participants == 6] == list(alone.rows)


def test_a_design_without_a_model_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    modelless = replace(designs.named("identification"), power="")
    monkeypatch.setattr(designs, "planned_design", lambda _study: modelless)
    with pytest.raises(PowerError) as refused:
        simulate.find("published", files.load(shipped("okamoto2012.toml")))
    assert refused.value.finding.where == "study okamoto2012"
    assert refused.value.finding.remedy


def test_progress_counts_every_chunk() -> None:
    totals: list[int] = []
    ticks: list[None] = []
    study = protocol()
    run(study, guess(study), studies=2500, total=totals.append, tick=lambda: ticks.append(None))
    assert totals == [len(ticks)] == [6]


def test_a_chunk_of_many_participants_holds_fewer_studies(monkeypatch: pytest.MonkeyPatch) -> None:
    study = protocol()
    whole = run(study, guess(study), participants=(4,), studies=20)
    monkeypatch.setattr(simulate, "CHUNK_CELLS", 20 * 7 * 9)
    held: list[int] = []

    def seen(work: Any, chunks: Sequence[Chunk]) -> Iterator[tuple[int, Any]]:
        held.extend(chunk.studies for chunk in chunks)
        return HERE(work, chunks)

    parts = run(study, guess(study), participants=(4,), studies=20, runner=seen)
    assert held == [9, 9, 2] * 2
    assert [row.tally.studies for row in parts.rows] == [row.tally.studies for row in whole.rows]


def test_one_participant_defines_nothing_and_says_so() -> None:
    study = protocol()
    result = run(study, guess(study), participants=(1,))
    undefined = {FLIPS in row.question.subject: row.tally.undefined for row in result.rows}
    assert undefined == {False: 300, True: 0}  # one participant has two signs, and P = 1
    assert {row.power for row in result.rows if row.question.alpha is not None} == {0.0}
    shown = report.text(result)
    assert "one participant" in shown
    assert "nan" not in shown.split()
    assert "NaN" not in document(result)


def test_participants_who_are_all_the_same_are_counted(approved: SnapshotAssertion) -> None:
    certain = ChoiceModel("test", tuple(Answers(task, np.eye(4, 5), np.zeros(4)) for task in ("virtual", "real")))
    study = protocol()
    result = run(study, certain)
    rows = [row for row in result.rows if row.kind == "model" and FLIPS not in row.question.subject]
    assert {row.tally.undefined for row in rows} == {300}
    # Where everybody is always right, sign flips have P = 2 / 2^n: 0.031 of six participants, 0.125 of four.
    flipped = [row for row in result.rows if row.kind == "model" and FLIPS in row.question.subject]
    assert {row.question.tasks: row.power for row in flipped} == {("virtual",): 1.0, ("real",): 0.0}
    shown = " ".join(report.text(result).split())
    assert "no variance" in shown
    assert [line for section in report.sections(result) for line in section.paragraphs] == approved
    assert "however many take part" not in shown
    assert result.row(result.questions[0], 6).quantiles is None  # type: ignore[union-attr]


def test_the_smallest_number_is_stated_with_its_uncertainty() -> None:
    study = protocol(t_test(0.5), materials=2, repetitions=400, people=(12,))
    result = run(study, two_answers(0.5, 0.04), participants=(3,), studies=100)
    question = result.questions[0]
    (row,) = [r for r in result.rows if r.question == question and r.kind == "model"]
    shares = {4: 79, 6: 85, 8: 70, 10: 81, 12: 85, 14: 95}
    rows = tuple(replace(row, participants=n, tally=replace(row.tally, significant=k)) for n, k in shares.items())
    needed = replace(result, rows=rows, participants=tuple(shares)).needed(question)
    # Wilson's limits of 70, 81, 85 and 95 of 100: 0.604 to 0.781, 0.722 to 0.875, 0.767 to 0.907, 0.888 to 0.978.
    # Nine participants were not tried, and may suffice.
    assert (needed.earliest, needed.likely, needed.surely) == (9, 10, 14)
    control = [replace(r, participants=4) for r in result.rows if r.question == question and r.kind == "guessing"]
    never = replace(result, rows=(*rows[:1], *control), participants=(4,))
    assert never.needed(question) == simulate.Needed(None, 2, None)  # one participant defines no t
    (numbers,) = re.findall(r"more than (\d+) \((\d+) to more than (\d+)\)", " ".join(report.text(never).split()))
    assert numbers == ("4", "2", "4")


@pytest.mark.parametrize("correction", [None, "materials and tasks"])
def test_the_risk_of_a_wrong_star_is_that_of_each_study_counted(correction: str | None) -> None:
    """One study at a time: which means lie above chance with P below alpha, of one material and of its family."""
    study = protocol()
    plan = study.analysis[0].model_copy(update={"correction": correction})
    study = study.model_copy(update={"analysis": (plan,)})
    result = run(study, guess(study), participants=(15,), studies=400)
    control = [row for row in result.rows if row.kind == "guessing"]
    model = guess(study).control(study)
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence(1, spawn_key=(1, 15, 0))))
    assert isinstance(model, ChoiceModel)
    found = planned_tests.answer(result.design, model.drawn(result.design, 15, 400, random))
    for row in control:
        asked, one = row.question, found[row.question]
        alike = [
            (k, other) for k, other in found.items()
            if (k.tasks == asked.tasks or correction) and k.adjusted == asked.adjusted
            and (FLIPS in k.subject) == (FLIPS in asked.subject)
        ]  # fmt: skip
        assert len(alike) == (8 if correction else 4)
        marks = [[p < 0.05 and up for p, up in zip(other.p, other.above, strict=True)] for _, other in alike]  # type: ignore[arg-type]
        assert row.tally.above == sum(p < 0.05 and up for p, up in zip(one.p, one.above, strict=True))  # type: ignore[arg-type]
        assert row.tally.family == sum(map(any, zip(*marks, strict=True)))
        assert row.tally.family >= row.tally.above
    (record, *_) = next(section for section in report.sections(result) if section.slug == "needed").records
    counted = control[0].tally.above or 0, control[0].tally.family or 0
    assert (record["type_i_error_above_planned"], record["type_i_error_of_family_planned"]) == tuple(
        count / 400 for count in counted
    )
    assert "which gets a star" in report.text(result)


def test_no_number_is_said_to_suffice_with_which_a_test_cannot_find_anything() -> None:
    """Sign flips need 2 / 2^n < 0.05, n = 6; where 10 of 15 do a task, 9 of a study are 6 in it, and 8 are 5."""
    certain = ChoiceModel("test", tuple(Answers(task, np.eye(4, 5), np.zeros(4)) for task in ("virtual", "real")))
    result = run(protocol(), certain, participants=(12, 15))
    found = {
        question.tasks[0]: result.needed(question) for question in result.questions if question.subject.endswith(FLIPS)
    }
    assert found == {"virtual": simulate.Needed(12, 6, 12), "real": simulate.Needed(12, 9, 12)}
    two_way = next(question for question in result.questions if question.test == "two-way ANOVA")
    assert [planned_tests.fewest(one, result.design, 12) for one in (result.questions[0], two_way)] == [2, 2]
    # No two-way ANOVA, and no t, is defined where all are always right.
    assert result.recommended().participants is None


@pytest.mark.parametrize(("test", "least"), [("order of tasks", 7), ("logit with participants", 6), ("equivalence", 2)])
def test_the_fewest_of_each_test(test: str, least: int) -> None:
    """2 / (4 over 2) = 0.33, 1 / (5 over 3) = 0.1, 2 / (6 over 3) = 0.1, 1 / (7 over 4) = 0.029: seven can."""
    study = protocol(people=(15, 15))
    question = planned_tests.Question(0, test, ("virtual", "real"), "?", 0.05)
    assert planned_tests.fewest(question, planned_tests.design(study, {}), 12) == least


def test_one_number_is_recommended_for_all_tests() -> None:
    study = protocol()
    result = run(study, guess(study), participants=(10, 25), studies=200)
    found = result.recommended()
    assert found.participants == 25
    assert {one.plan for one in found.lacking} == {0, 1, 2}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"participants": ()}, r"--participants: got none; allowed: numbers from 1 to 1000"),
        ({"participants": (0, 3)}, r"--participants: got 0, 3; allowed"),
        ({"participants": (1001,)}, r"--participants: got 1001; allowed"),
        ({"studies": 0}, r"--studies: got 0; allowed: 1 to 1000000"),
    ],
)
def test_sizes_beyond_what_is_allowed_are_refused(changed: dict[str, Any], message: str) -> None:
    study = protocol()
    with pytest.raises(PowerError, match=message):
        run(study, guess(study), **changed)


def test_counts_whose_squares_are_not_exact_are_refused(refuses: Refuses) -> None:
    study = protocol(t_test(0.25), repetitions=1000)
    many = tuple(study.materials[0].model_copy(update={"id": f"m{i}"}) for i in range(60))
    with refuses(PowerError):
        run(study.model_copy(update={"materials": many}), guess(study), participants=(1000,))


def test_files_say_simulated_and_may_be_written_again(tmp_path: Path, refuses: Refuses) -> None:
    study = protocol()
    result = run(study, guess(study), participants=(4, 6), studies=40)
    files = report.write(result, tmp_path / "out")
    assert {path.name for path in files} == {
        *(f"{slug}.{kind}" for slug in SLUGS for kind in ("csv", "md", "tex")), "power.svg", "power.png",
    }  # fmt: skip
    for path in (tmp_path / "out").iterdir():
        if path.suffix != ".png":
            text = path.read_text("utf-8")
            assert "SIMULATED studies" in text, path
            assert "nan" not in text.lower().split(","), path
    before = {path: path.read_bytes() for path in files}
    assert report.write(result, tmp_path / "out") == files
    assert {path: path.read_bytes() for path in files} == before
    (tmp_path / "out" / "power.md").write_text("mine", "utf-8")
    with refuses(DatasetError):
        report.write(result, tmp_path / "out")


def test_what_is_simulated_after_a_reconstruction_says_so(tmp_path: Path, repository_root: Path) -> None:
    study = protocol()
    result = run(study, fitted(repository_root / "participants" / "okamoto2012", study), participants=(4,), studies=20)
    label = f"SIMULATED studies, after: {LABELS['RECONSTRUCTION']}"
    assert report.as_dict(result)["label"] == label
    assert report.text(result).startswith(label)
    for path in report.write(result, tmp_path / "out"):
        if path.suffix in (".csv", ".md", ".tex"):
            assert label in path.read_text("utf-8"), path


def test_the_monte_carlo_error_stands_where_the_shares_do(tmp_path: Path) -> None:
    """Wilson's interval from statsmodels; a terminal has no room for one a share, and names the widest."""
    study = protocol(t_test(0.25))
    result = run(study, guess(study), participants=(4, 15))
    shown = " ".join(report.text(result).split())
    assert "Brackets show" not in shown
    reaches: list[tuple[simulate.Row, float]] = []
    for row in result.rows:
        low, high = proportion_confint(row.tally.significant, 300, method="wilson")
        share = row.tally.significant / 300
        reaches.append((row, max(high - share, share - low)))
    by_size = max(reach for row, reach in reaches if row.kind == "model" and not row.question.adjusted)
    planned = max(reach for row, reach in reaches if row.participants == 15)
    said = re.findall(r"Wilson's 95 % intervals extend at most (\S+) to either side", shown)
    assert [float(one) for one in said] == [math.ceil(by_size * 1000) / 1000, math.ceil(planned * 1000) / 1000]
    report.write(result, tmp_path / "out")
    for name in ("power.md", "needed.md"):
        assert "Brackets show" in (tmp_path / "out" / name).read_text("utf-8")


def test_what_a_terminal_shows() -> None:
    study = protocol()
    result = run(study, guess(study), participants=(4, 15))
    shown = report.text(result)
    assert max(map(len, shown.splitlines())) <= 100
    assert shown.startswith("SIMULATED studies")
    for title in ("Simulated studies", "Power by number of participants", "Estimates", "Not defined", "needed"):
        assert title in shown
    assert "4 (4, 3)" in shown
