"""Extreme cases: they hold, and each kind notices what it is there to notice."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from analysis.numerics import cases as numerics_cases
from analysis.numerics import cases as numerics_invariants
from analysis.numerics import refusals
from analysis.numerics.cases import Case, Outcome, refused, settle
from experiment import synthesis
from experiment.errors import SynthesisError
from experiment.synthesis import basis, crinkle, response, shaping, waveforms
from experiment.synthesis.basis import Weight
from experiment.synthesis.crinkle import CrinkleSpectra, SpectrumAtSpeed
from experiment.synthesis.engine import FASTEST_FIRST
from experiment.synthesis.limiter import limit

CASES = [*numerics_cases.cases(), *refusals.cases(limit)]


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
    assert {name for group, name in given if group == "response"} >= {
        "a null: no answer at 300 Hz",
        "a plateau between two levels",
        "a reversal between two levels",
    }


NUMBERS = ("float", "ArrayLike", "NDArray[np.float64]", "tuple[float, float]", "tuple[float, float] | None")
"""Annotations of what could be NaN or infinite."""


def test_every_number_that_a_public_function_takes_is_tried_with_nan_and_infinity() -> None:
    tried = {case.given.partition(",")[0] for case in CASES if case.group == "NaN and infinity"}
    wanted = {"CrinkleSpectra: speeds_mm_s", "CrinkleSpectra: amplitudes", "CrinkleSpectra: signs"}
    wanted |= {"Response: frequencies_hz", "Response: levels_v", "Response: accelerations_m_s2"}
    wanted |= {f"{method.name}: speed_mm_s" for method in FASTEST_FIRST} | {"first block alone: speed_mm_s"}
    for found in pkgutil.iter_modules(synthesis.__path__):
        module = importlib.import_module(f"{synthesis.__name__}.{found.name}")
        for name, function in inspect.getmembers(module, inspect.isfunction):
            if function.__module__ == module.__name__ and not name.startswith("_"):
                taken = inspect.signature(function).parameters.values()
                wanted |= {f"{name}: {one.name}" for one in taken if one.annotation in NUMBERS}
    assert wanted - tried == {"methods: band_hz"}, "which nothing looks at before `choose`"
    assert len(wanted) > 40


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
    right = basis.BasisRenderer.weighted

    def wrong(self: basis.BasisRenderer, where: Weight, samples: slice = slice(None)) -> NDArray[np.float64]:
        return right(self, replace(where, of_difference=where.of_difference * (1 + 1e-10)), samples)

    monkeypatch.setattr(basis.BasisRenderer, "weighted", wrong)
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


def test_an_input_that_is_not_checked_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (response, shaping):
        monkeypatch.setattr(module, "finite", lambda values, *, what: np.asarray(values))
    settled = outcome("shape: coefficients")
    assert not settled.holds
    assert settled.seen.startswith("NaN: accepted")


def test_the_printed_difference_is_noticed_at_the_measured_speeds(monkeypatch: pytest.MonkeyPatch) -> None:
    right = crinkle.at_speed

    def printed(spectra: CrinkleSpectra, *, speed_mm_s: float) -> SpectrumAtSpeed:
        return right(spectra, speed_mm_s=speed_mm_s, literal=True)

    monkeypatch.setattr(numerics_cases, "at_speed", printed)
    assert "a jump of" in outcome("200 mm/s, one rounding below and above").seen


def test_a_reversal_that_is_accepted_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(response, "not_rising", lambda _: None)
    assert outcome("a reversal between two levels").seen == "the table: accepted"


def test_a_limiter_that_lets_nan_through_is_noticed() -> None:
    def leaking(waveform_m_s2: ArrayLike, peak_m_s2: float) -> tuple[NDArray[np.float64], int]:
        return np.clip(np.asarray(waveform_m_s2), -peak_m_s2, peak_m_s2), 0

    settled = {one.given: settle(one).holds for one in refusals.cases(leaking) if one.group == "limiter"}
    assert not settled["NaN"]
    assert settled["infinity"]
    assert not settled["NaN and infinity as the limit"]


def test_the_oracle_is_checked_against_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numerics_cases, "BINS", numerics_invariants.BINS + 1)
    assert not outcome("44100 Hz").holds
