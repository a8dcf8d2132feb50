"""Power of detection at one level: d' of studies as an analysis has them, type I error, and the models."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtri
from scipy.stats import norm, ttest_1samp

from palpate.analysis.designs.detection import results
from palpate.analysis.power import planned_tests, simulate
from palpate.analysis.power.detections import DetectionModel, draw
from palpate.analysis.reading.dataset import read
from palpate.analysis.statistics.psychophysics.sensitivity import sensitivity
from palpate.experiment.errors import PowerError
from palpate.experiment.protocol.models import Protocol
from tests.analysis.designs.detection.sample import BLANK, SIGNAL, dataset
from tests.experiment.protocol.detection import UP_DOWN, detecting
from tests.experiment.protocol.detection import protocol as study

INTERVALS = (1, 2)


def found(protocol: Protocol, name: str) -> DetectionModel:
    model = simulate.find(name, protocol)
    assert isinstance(model, DetectionModel)
    return model


@pytest.mark.parametrize("intervals", INTERVALS)
def test_d_of_many_trials_is_that_of_the_model_and_of_an_analysis(intervals: int) -> None:
    """Closed form: with many trials, d' of every study is what was drawn; from shares by equation 1.5 and 7.2."""
    (one, *_) = found(study(intervals), "1.5,0").tasks
    many = replace(one, shown=100_000, others=100_000)
    assert draw(many, 4, 3, np.random.default_rng(1)) == pytest.approx(1.5, abs=0.05)
    reach = 0.75 if intervals == 1 else 1.5 / 2**0.5
    hits, alarms = (round(20 * float(norm.cdf(at))) for at in (reach, -reach))
    rule = "yes or no" if intervals == 1 else "two intervals"
    z = (ndtri((hits + 0.5) / 21) - ndtri((alarms + 0.5) / 21)) / (1 if intervals == 1 else 2**0.5)
    assert sensitivity(hits, 20, alarms, 20, rule).d == pytest.approx(z)  # type: ignore[arg-type]


@pytest.mark.parametrize("intervals", INTERVALS)
def test_p_is_student_s_and_nothing_is_found_as_often_as_alpha_says(intervals: int) -> None:
    """Of 2,000 studies of 10; binomial limits at 0.001 are 3.5 and 6.7 %."""
    protocol = study(intervals)
    planned, model = planned_tests.design(protocol, {}), found(protocol, "1,0.5")
    every, _ = model.answers(planned, 10, 5, np.random.default_rng(2))
    drawn = draw(model.tasks[0], planned.sizes(10)[0], 5, np.random.default_rng(2))
    own = next(one.p for question, one in every.items() if question.alpha is not None)
    assert own == pytest.approx(ttest_1samp(drawn[..., 0], 0.0, axis=1).pvalue)
    control, _ = model.control(protocol).answers(planned, 10, 2000, np.random.default_rng(3))
    share = next(np.mean(one.p < 0.05) for one in control.values() if one.p is not None)
    assert 0.035 < share < 0.067


def test_a_file_states_each_signal(tmp_path: Path) -> None:
    protocol = study(2)
    (one, *_) = found(protocol, "1,0.5").tasks
    values = "".join(f'[[values]]\nmaterial = "{name}"\nvalue = 0.8\n' for name in one.values)
    (tmp_path / "model.toml").write_text(f'format = 1\nsource = "ours"\nspread = 0.3\n{values}', "utf-8")
    (stated, *_) = found(protocol, str(tmp_path / "model.toml")).tasks
    assert (set(stated.values.values()), stated.spread) == ({0.8}, 0.3)


def test_tasks_with_levels_have_no_such_model() -> None:
    with pytest.raises(PowerError):
        simulate.find("1,0.5", study(2, UP_DOWN))


def rows(hits: int, alarms: int) -> list[dict[str, object]]:
    said = [(SIGNAL, place < hits) for place in range(20)] + [(BLANK, place < alarms) for place in range(20)]
    return [
        {"trial": trial, "attempt": 1, "counted": True, "presented": shown, "answered": "yes" if yes else "no"}
        for trial, (shown, yes) in enumerate(said, start=1)
    ]


def test_the_model_of_a_dataset_has_the_mean_that_its_analysis_shows(tmp_path: Path) -> None:
    """z((h + 1/2) / 21) - z((f + 1/2) / 21) of two participants, and R's qt(0.975, 1) = 12.7062."""
    root = dataset(tmp_path / "study", 1, {"1": rows(18, 2), "2": rows(14, 6)}, **detecting(1))
    own = [float(ndtri((h + 0.5) / 21) - ndtri((f + 0.5) / 21)) for h, f in ((18, 2), (14, 6))]
    (found,) = results.compute(read(root)).tasks
    shown = results.mean_d(found)[SIGNAL]
    half = 12.7062 * float(np.std(own, ddof=1)) / 2**0.5
    assert shown.n == 2
    assert shown.value == pytest.approx(np.mean(own))
    assert shown.low == pytest.approx(np.mean(own) - half, abs=1e-4)
    assert shown.high == pytest.approx(np.mean(own) + half, abs=1e-4)
