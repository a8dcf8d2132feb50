"""Extreme cases: they hold, and each kind notices what it is there to notice."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace

import pytest

from palpate.analysis.numerics import cases as numerics_cases
from palpate.analysis.numerics.cases import Case, Outcome, refused, settle
from palpate.experiment.errors import SynthesisError
from palpate.experiment.synthesis import crinkle, waveforms
from palpate.experiment.synthesis.crinkle import CrinkleSpectra, SpectrumAtSpeed
from palpate.experiment.synthesis.waveforms import Basis, Stimulus

CASES = numerics_cases.cases()


def outcome(given: str, cases: Callable[[], list[Case]] = lambda: CASES) -> Outcome:
    (case,) = [case for case in cases() if case.given == given]
    return settle(case)


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.group}: {case.given}")
def test_it_holds(case: Case) -> None:
    settled = settle(case)
    assert settled.holds, settled.seen
    assert settled.seen


def test_every_case_of_the_issue_is_there() -> None:
    given = {(case.group, case.given) for case in CASES}
    for v in ("0", "1e-06", "10000", "exactly 50", "exactly 100", "exactly 200", "exactly 300"):
        assert ("speed", f"{v} mm/s") in given
    for name in ("zeros", "one bin", "denormals", "1e300 m/s^2", "a bin that falls to zero"):
        assert ("spectrum", name) in given
    assert ("spectrum", "panel louder than object everywhere") in given
    assert {("length", name) for name in ("N = 1", "N = 9, odd", "N = 59, prime")} <= given


def test_an_unexpected_exception_breaks_an_invariant() -> None:
    def explodes() -> tuple[bool, str]:
        raise ZeroDivisionError("as planned")

    settled = settle(Case("group", "given", "invariant", explodes))
    assert (settled.holds, settled.seen) == (False, "ZeroDivisionError: as planned")


def test_a_warning_breaks_an_invariant() -> None:
    def warns() -> tuple[bool, str]:
        warnings.warn("overflow", RuntimeWarning, stacklevel=1)
        return True, "fine"

    assert not settle(Case("group", "given", "invariant", warns)).holds


def test_refused_names_what_was_accepted_and_what_failed_otherwise() -> None:
    def raises(error: Exception) -> Callable[[], object]:
        def call() -> object:
            raise error

        return call

    assert refused([("a", raises(SynthesisError("no")))]) == (True, "SynthesisError for a")
    assert refused([("a", raises(SynthesisError("no"))), ("b", lambda: 1), ("c", raises(TypeError("no")))]) == (
        False,
        "b: accepted; c: TypeError",
    )


def test_a_weighted_sum_that_errs_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    right = Basis.at

    def wrong(self: Basis, speed_mm_s: float) -> Stimulus:
        made = right(self, speed_mm_s)
        return replace(made, of_difference=made.of_difference * (1 + 1e-10))

    monkeypatch.setattr(Basis, "at", wrong)
    settled = outcome("1e300 m/s^2")
    assert not settled.holds
    assert "basis waveforms" in settled.seen
    assert settled.seen.endswith("of the error claimed")


def test_a_forgotten_floor_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    right = crinkle.at_speed

    def wrong(spectra: CrinkleSpectra, *, speed_mm_s: float, literal: bool = False) -> SpectrumAtSpeed:
        return replace(right(spectra, speed_mm_s=speed_mm_s, literal=literal), floored_bins=0)

    monkeypatch.setattr(waveforms, "at_speed", wrong)
    assert "bins floored and dropped: (0, 0), not" in outcome("10000 mm/s").seen


def test_the_printed_difference_is_noticed_at_the_measured_speeds(monkeypatch: pytest.MonkeyPatch) -> None:
    right = crinkle.at_speed

    def printed(spectra: CrinkleSpectra, *, speed_mm_s: float) -> SpectrumAtSpeed:
        return right(spectra, speed_mm_s=speed_mm_s, literal=True)

    monkeypatch.setattr(numerics_cases, "at_speed", printed)
    assert "a jump of" in outcome("200 mm/s, one rounding step below and above").seen


def test_the_oracle_is_checked_against_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numerics_cases, "BINS", numerics_cases.BINS + 1)
    assert not outcome("44100 Hz").holds
