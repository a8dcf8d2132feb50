"""The whole of `palpate numerics`, at a tiny extent: what it prints, writes and judges."""

from __future__ import annotations

import csv
import json
import runpy
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from palpate.analysis.numerics import cases, contact, force, numerics, played, report
from palpate.analysis.numerics.numerics import FULL, QUICK, Extent, Numerics
from palpate.experiment.cli.app import app
from palpate.experiment.errors import DatasetError
from palpate.experiment.synthesis import spectra
from tests.analysis.numerics.test_numerics_measured import TINY
from tests.approved import Refuses

NAMES = {
    "synthesis.csv",
    "resampling.csv",
    "shaping.csv",
    "noise.csv",
    "voltages.csv",
    "samples.csv",
    "conditions.csv",
    "budget.csv",
    "budget.png",
    "budget.svg",
    "methods.md",
    "played.npz",
    "force.csv",
    "force.npz",
    "contact.csv",
    "contact.png",
    "contact.svg",
    "cases.csv",
    "numerics.md",
    "numerics.png",
    "numerics.svg",
}


@pytest.fixture(scope="module", autouse=True)
def few_cases() -> Iterator[None]:
    """All cases are settled by tests of their own."""
    with pytest.MonkeyPatch.context() as patch:
        for module, kept in ((cases, "length"), (played, "one speed"), (contact, "no ")):
            some = [case for case in module.cases() if f"{case.group}, {case.given}".find(kept) >= 0]
            patch.setattr(module, "cases", lambda some=some: some)
        yield


@pytest.fixture(scope="module")
def result() -> Numerics:
    return numerics.run(replace(TINY, devices=QUICK.devices))


def test_everything_holds(result: Numerics) -> None:
    assert result.broken == ()
    assert not result.failed
    assert result.verdict == (
        f"All {sum(one.claimed is not None for one in result.measured)} claimed bounds on errors, "
        f"{len(result.outcomes)} invariants and "
        f"{len(result.played) + len(result.pushed[0].truth)} budgets pass."
    )


def test_the_command_ends_with_1_where_an_invariant_is_broken(
    monkeypatch: pytest.MonkeyPatch, result: Numerics
) -> None:
    broken = replace(result, outcomes=(replace(result.outcomes[0], holds=False), *result.outcomes[1:]))
    for made, code in ((result, 0), (broken, 1)):
        monkeypatch.setattr(numerics, "run", lambda *_, made=made, **__: made)
        assert CliRunner().invoke(app, ["numerics"], catch_exceptions=False).exit_code == code


def test_the_command_says_where_its_tables_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, result: Numerics
) -> None:
    monkeypatch.setattr(numerics, "run", lambda *_, **__: result)
    monkeypatch.setattr(report, "write", lambda *_: ())
    asked = ["numerics", "--out", str(tmp_path / "out")]
    told = f"Tables, plots and played signals: {tmp_path / 'out'}\n"
    assert CliRunner().invoke(app, asked, catch_exceptions=False).stdout.endswith(told)
    assert told not in CliRunner().invoke(app, [*asked, "--json"], catch_exceptions=False).stdout


def test_a_file_in_the_way_is_found_before_anything_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuses: Refuses
) -> None:
    def measured(*_: object, **__: object) -> Numerics:
        raise AssertionError("measured")

    monkeypatch.setattr(numerics, "run", measured)
    (tmp_path / "noise.csv").write_text("mine")
    with refuses(DatasetError):
        CliRunner().invoke(app, ["numerics", "--out", str(tmp_path)], catch_exceptions=False)
    assert [path.name for path in tmp_path.iterdir()] == ["noise.csv"]
    with refuses(DatasetError):
        CliRunner().invoke(app, ["numerics", "--out", str(tmp_path / "noise.csv")], catch_exceptions=False)


def test_progress_counts_every_step() -> None:
    totals: list[int] = []
    ticks: list[None] = []
    made = numerics.run(
        replace(TINY, lengths=(50,), output_rates_hz=(48_000,)),
        total=totals.append,
        tick=lambda: ticks.append(None),
    )
    assert totals == [len(ticks)] == [len(made.measured) + len(made.outcomes) + len(made.materials)]


def test_quick_and_full_differ_in_extent_alone(monkeypatch: pytest.MonkeyPatch, result: Numerics) -> None:
    asked: list[Extent] = []

    def run(extent: Extent, **_: object) -> Numerics:
        asked.append(extent)
        return result

    monkeypatch.setattr(numerics, "run", run)
    for arguments in (["numerics", "--quick"], ["numerics"]):
        CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert asked == [QUICK, FULL]


def test_a_broken_invariant_fails_and_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cases, "inverse", lambda c: spectra.inverse(c) * 1.001)
    made = numerics.run(replace(TINY, lengths=(50,), output_rates_hz=(48_000,)))
    assert made.failed
    (found,) = [line for line in made.broken if line.startswith("length, N = 60: off by")]
    shown = report.text(made)
    assert found in shown
    assert max(map(len, shown.splitlines())) <= 100
    assert report.as_dict(made)["failed"] is True


def test_an_error_above_its_claim_fails_and_is_named(result: Numerics) -> None:
    claimed = next(one for one in result.measured if one.claimed is not None)
    made = replace(result, measured=(replace(claimed, error=1.0),), outcomes=())
    assert made.failed
    (line,) = made.broken
    assert line.startswith(f"synthesis, {claimed.way}: error 1, above ")


def test_an_error_that_is_no_number_fails(result: Numerics) -> None:
    unclaimed = next(one for one in result.measured if one.claimed is None)
    assert replace(result, measured=(replace(unclaimed, error=float("nan")),)).failed


def test_what_a_terminal_shows(result: Numerics) -> None:
    shown = report.text(result)
    assert max(map(len, shown.splitlines())) <= 100
    assert shown.startswith("SIMULATED spectra")
    titles = ("Synthesis", "Voltages", "Samples", "Resampling", "Frequency shaping", "Noise of the masker")
    for title in (*titles, "Condition numbers", "Error budget", "Extreme cases"):
        assert title in shown
    assert "N = 60 at 48000 Hz, 170 mm/s" in shown
    assert " ".join(result.verdict.split()) in " ".join(shown.split())


def test_dominated_is_explained_where_it_is_printed(result: Numerics) -> None:
    for section in report.sections(result):
        says = any(paragraph.startswith("A method is dominated if") for paragraph in section.paragraphs)
        assert says is any("dominated" in table.header for table in section.tables), section.slug


def test_json_has_every_row(result: Numerics) -> None:
    document = json.loads(json.dumps(report.as_dict(result), allow_nan=False))
    assert (document["failed"], document["label"]) == (result.failed, "SIMULATED spectra")
    rows = sum(len(document[slug]) for slug in report.TITLES)
    assert rows == len(result.measured)
    assert [row["truth"] for row in document["budget"]] == [one.truth for one in result.played]
    assert len(document["conditions"]) == len(result.conditions)
    assert len(document["cases"]) == len(result.outcomes)
    assert float(document["software"]["oracle_epsilon"]) > 0


def test_the_truth_of_a_force_can_be_found_by_other_means(
    result: Numerics, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By a program that imports no line of palpate; the filter finds the force that was sent as well."""
    file = Path(__file__).with_name("force_by_hand.py")
    assert "import palpate" not in file.read_text("utf-8")
    (tmp_path / "numerics").mkdir()
    (tmp_path / "numerics" / "force.npz").write_bytes(force.arrays(result.pushed))
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(file))
    [one] = result.pushed
    lines = [line.rsplit(maxsplit=7) for line in capsys.readouterr().out.splitlines()]
    assert [float(line[1]) for line in lines] == [felt.speed_mm_s for felt in one.budget.felt]
    for (name, _, *numbers), truth in zip(lines, one.truth, strict=True):
        within, told, beyond, told_beyond, _, off_n = map(float, numbers)
        assert (name, told, told_beyond) == (one.name, truth["trembling"], truth["limit"])
        assert (within, beyond) == pytest.approx((told, told_beyond), rel=1e-6)
        assert off_n < 1e-6


def test_a_budget_of_force_that_misses_a_cause_does_not_hold(result: Numerics) -> None:
    [one] = result.pushed
    felt = replace(one.budget.felt[0], errors=one.budget.felt[0].errors | {"trembling": 0.0})
    wrong = replace(one, budget=replace(one.budget, felt=(felt, *one.budget.felt[1:])))
    made = replace(result, pushed=(wrong,))
    assert made.failed
    assert len(made.broken) == 1


def test_files_are_whole_and_may_be_written_again(
    result: Numerics, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = report.write(result, tmp_path)
    assert {path.name for path in files} == NAMES == set(report.FILES)
    assert (tmp_path / "numerics.png").read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in (tmp_path / "numerics.svg").read_bytes()
    with (tmp_path / "synthesis.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    measured = [one for one in result.measured if one.subject == "synthesis"]
    assert [float(row["error"]) for row in rows] == [one.error for one in measured]
    assert {row["dataset"] for row in rows} == {"SIMULATED spectra"}
    for slug in ("resampling", "shaping", "noise", "contact", "force", "cases"):
        assert "SIMULATED spectra" not in (tmp_path / f"{slug}.csv").read_text("utf-8")
    with (tmp_path / "cases.csv").open(encoding="utf-8", newline="") as file:
        assert [row["holds"] for row in csv.DictReader(file)] == [str(one.holds) for one in result.outcomes]
    page = (tmp_path / "numerics.md").read_text(encoding="utf-8")
    assert page.startswith("**SIMULATED spectra**")
    assert result.verdict in page
    # Drawing takes seconds, and the same figures again prove nothing of the files.
    for kind in ("svg", "png"):
        monkeypatch.setattr(report, kind, lambda _: b"drawn again")
    assert report.write(result, tmp_path) == files
    assert (tmp_path / "numerics.png").read_bytes() == b"drawn again"


def test_a_file_of_someone_else_is_left_alone(result: Numerics, tmp_path: Path, refuses: Refuses) -> None:
    (tmp_path / "noise.csv").write_text("mine", "utf-8")
    with refuses(DatasetError):
        report.write(result, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["noise.csv"]


def test_two_runs_measure_and_judge_the_same(result: Numerics) -> None:
    other = numerics.run(TINY)
    assert [(one.given, one.holds) for one in other.outcomes] == [(one.given, one.holds) for one in result.outcomes]
    for again, first in zip(other.measured, result.measured, strict=True):
        assert (again.way, again.given, again.claimed) == (first.way, first.given, first.claimed)
        assert again.error == pytest.approx(first.error, rel=1e-6, abs=1e-15)
