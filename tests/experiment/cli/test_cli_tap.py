"""`palpate tap`: what it prints, as text and as JSON, and what it refuses."""

from __future__ import annotations

import json
from math import exp, pi
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile
from syrupy.assertion import SnapshotAssertion
from typer.testing import CliRunner

from palpate.experiment.cli.app import app
from palpate.experiment.errors import PalpateError
from tests.conftest import Palpate

IMPACT = ["tap", "contact", "--stiffness", "4000", "--damping", "0", "--mass", "0.1", "--speed", "0.2"]


def run(*arguments: str) -> str:
    made = CliRunner().invoke(app, list(arguments), catch_exceptions=False)
    assert made.exit_code == 0, made.output
    return made.stdout


def test_an_impact_as_json() -> None:
    made = json.loads(run(*IMPACT, "--json"))
    assert made["release_s"] == pytest.approx(pi / 200, rel=1e-14)
    assert made["rebound_m_s"] == pytest.approx(0.2, rel=1e-14)
    assert made["penetration_m"] == pytest.approx(0.001, rel=1e-14)
    assert made["peak_s"] == pytest.approx(pi / 400, rel=1e-14)
    assert (made["dissipated_j"], made["left_in_spring_j"]) == (0.0, 0.0)
    assert (made["why"], made["stable"], made["plot"]) == (None, True, None)


def test_what_is_never_released_is_null_and_says_why(approved: SnapshotAssertion) -> None:
    made = json.loads(
        run(
            "tap",
            "contact",
            *["--stiffness", "2500", "--damping", "100", "--mass", "1", "--speed", "0.2", "--law", "printed", "--json"],
        )
    )
    assert made["release_s"] is made["rebound_m_s"] is made["dissipated_j"] is None
    assert made["penetration_m"] == pytest.approx(0.2 / 50 * exp(-1), rel=1e-14)
    assert made["why"] == approved


def test_a_method_that_is_not_stable_says_so() -> None:
    said = run(*IMPACT, "--method", "euler", "--rate", "10000")
    assert 0 < said.index("NOT STABLE, ") < said.index("rebound")


def test_the_plot_goes_where_it_is_asked(tmp_path: Path) -> None:
    said = run(*IMPACT, "--force", "0.5", "--plot", str(tmp_path / "impact.png"))
    assert f"Plot: {tmp_path / 'impact.png'}" in said
    assert (tmp_path / "impact.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--mass", "-1"], "mass: got -1 kg; allowed: a finite number above zero"),
        (["--stiffness", "nan"], "stiffness: got nan N/m"),
        (["--law", "sticky"], "--law: got 'sticky'; allowed: clamped, printed"),
        (["--method", "rk5"], "method: got 'rk5'; allowed: euler"),
        (["--rate", "0"], "rate: got 0 Hz"),
        (["--plot", "tap.txt"], "got the suffix '.txt'; allowed: .svg, .png, .pdf"),
    ],
)
def test_what_is_no_impact_is_refused(arguments: list[str], words: str) -> None:
    with pytest.raises(PalpateError, match=words) as refused:
        CliRunner().invoke(app, [*IMPACT, *arguments], catch_exceptions=False)
    assert refused.value.exit_code == 2


def test_a_stiffness_with_a_unit_is_refused() -> None:
    made = CliRunner().invoke(app, [*IMPACT, "--stiffness", "4500N"])
    assert made.exit_code == 2
    assert "--stiffness" in made.output


def test_recordings_are_fitted(tmp_path: Path, approved: SnapshotAssertion) -> None:
    t = np.arange(5000) / 50_000
    wavfile.write(tmp_path / "tap.wav", 50_000, np.exp(-60 * t) * np.cos(2 * np.pi * 500 * t))
    made = json.loads(run("tap", "fit", str(tmp_path / "tap.wav"), "--json"))
    assert made["recordings"][0]["f_hz"] == pytest.approx(500)
    assert made["set"] is None
    table = tmp_path / "taps.csv"
    table.write_text("file,surface,stiffness_n_m,speed_m_s\ntap.wav,wood,19000,0.2\n")
    told = run("tap", "fit", str(tmp_path / "tap.wav"), "--taps", str(table))
    assert told.partition("Amplitude ")[2] == approved


def test_a_misfit_ends_with_1(tmp_path: Path) -> None:
    wavfile.write(tmp_path / "noise.wav", 50_000, np.random.default_rng(1).normal(size=4000))
    made = CliRunner().invoke(app, ["tap", "fit", str(tmp_path / "noise.wav")], catch_exceptions=False)
    assert made.exit_code == 1
    assert "MISFIT" in made.stdout


def test_an_impact_of_no_finite_energy_is_refused_in_a_line(palpate: Palpate, approved: SnapshotAssertion) -> None:
    numbers = ("--stiffness", 2500, "--damping", 10, "--mass", "1e300", "--speed", "1e300")
    code, out, err = palpate("tap", "contact", *numbers)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err == approved


def test_a_block_at_the_end_of_the_range_answers_in_numbers() -> None:
    """Without a damper the mass is back after half a turn, at its speed."""
    numbers = ["--stiffness", "1e300", "--damping", "0", "--mass", "0.001", "--speed", "1e6"]
    made = json.loads(run("tap", "contact", *numbers, "--json"))
    assert made["release_s"] == pytest.approx(pi / (1e150 * 1000**0.5), rel=1e-14, abs=0.0)
    assert made["rebound_m_s"] == pytest.approx(1e6, rel=1e-14)


def test_every_wrong_number_of_an_impact_is_told_at_once(palpate: Palpate) -> None:
    code, _, err = palpate("tap", "contact", "--stiffness", -5, "--damping", -1, "--mass", 0, "--speed", 0)
    assert code == 2
    assert [name in err for name in ("stiffness: got -5", "damping: got -1", "mass: got 0", "speed: got 0")] == [
        True
    ] * 4
