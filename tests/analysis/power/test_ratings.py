"""Power of ratings: the tests of one study each, type I error, the law of Stevens within a scale's ends, models."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import ttest_1samp
from syrupy.assertion import SnapshotAssertion

from palpate.analysis.power import planned_tests, ratings, report, simulate
from palpate.analysis.power.ratings import Raters, RatingModel, draw
from palpate.analysis.statistics.icc import icc
from palpate.analysis.statistics.participants import repeated
from palpate.analysis.statistics.psychophysics.magnitude import power_law
from palpate.experiment.errors import PowerError
from palpate.experiment.protocol.designs.rating import Rating
from palpate.experiment.protocol.files import load, shipped
from palpate.experiment.protocol.models import Protocol
from tests.analysis.datasets import trials, write_dataset
from tests.approved import Refuses


def study() -> Protocol:
    return load(shipped("rating.toml"))


def without_law() -> Protocol:
    own = study()
    return own.model_copy(update={"analysis": tuple(test for test in own.analysis if test.test != ratings.LAW)})


def found(name: str, protocol: Protocol) -> RatingModel:
    model = simulate.find(name, protocol)
    assert isinstance(model, RatingModel)
    return model


def answers(model: RatingModel, people: int, studies: int) -> dict[str, planned_tests.Answer]:
    planned = planned_tests.design(study(), {})
    every, _ = model.answers(planned, people, studies, np.random.default_rng(3))
    return {question.subject: answer for question, answer in every.items()}


def test_every_simulated_study_is_tested_as_an_analysis_tests_it() -> None:
    """Those of one study stand against R; the mean exponent is tested by scipy's t."""
    model = found("0.5,0.2", study())
    seen = answers(model, 6, 4)
    given = np.array(model.scale)[draw(model, model.tasks[0], 10, 6, 4, np.random.default_rng(3))]
    magnitudes = 10 ** np.array(model.magnitudes)
    for place, own in enumerate(given):
        (effect,) = repeated(own.mean(axis=-1), ("materials",))
        forms = icc(own.mean(axis=-1).T.tolist())
        exponents = [power_law(np.repeat(magnitudes, 10), one.ravel()).exponent for one in own]
        expected = {
            "materials": effect.p, "exponent other than 0": ttest_1samp(exponents, 0.0).pvalue,
            "mean exponent": np.mean(exponents), **{name: forms.form(name).value for name in ratings.FORMS},
        }  # fmt: skip
        for subject, value in expected.items():
            one = seen[subject]
            numbers = one.estimate if one.p is None else one.p
            assert numbers is not None
            assert numbers[place] == pytest.approx(value, rel=1e-9)


def test_materials_that_are_alike_are_found_to_differ_as_often_as_alpha_says() -> None:
    """Of 3,000 studies of 12; binomial limits at 0.001 are 3.7 and 6.4 %, and Huynh and Feldt's test is careful."""
    seen = answers(found("0.5,0.2", study()).control(study()), 12, 3000)
    shares = {subject: np.mean(one.p < 0.05) for subject, one in seen.items() if one.p is not None}
    assert 0.036 < shares["exponent other than 0"] < 0.065
    assert 0.02 < shares["materials"] < 0.065
    exponent = seen["mean exponent"].estimate
    assert exponent is not None
    assert exponent.mean() == pytest.approx(0.0, abs=0.005)


def test_a_mean_exponent_spreads_as_its_raters_do_where_the_scale_has_no_ends() -> None:
    """Closed form: the variance of a slope, (spread^2 + scatter^2 / repetitions) / sum of squares, over n raters."""
    own = found("0.5,0.2", study())
    wide = replace(own, scale=tuple(10 ** np.linspace(-3, 4, 2001)))
    seen = answers(wide, 8, 4000)["mean exponent"].estimate
    assert seen is not None
    apart = np.array(own.magnitudes) - np.mean(own.magnitudes)
    variance = (0.2**2 + 0.2**2 / 10) / (apart @ apart) / 8
    assert seen.mean() == pytest.approx(0.5, abs=0.01)
    assert seen.var() == pytest.approx(variance, rel=0.1)
    ends = answers(own, 8, 4000)["mean exponent"].estimate
    assert ends is not None
    assert ends.mean() < 0.45


def test_two_numbers_are_in_the_scales_own_where_no_law_is_planned(refuses: Refuses) -> None:
    (own,) = found("2,1.5", without_law()).tasks
    assert own.values == pytest.approx([4.0, 4 + 2 / 3, 5 + 1 / 3, 6.0])
    assert (own.level, own.spread, own.scatter) == (1.5, 1.5, 1.5)
    with refuses(PowerError):
        found("2,0", study())
    with refuses(PowerError):
        found("published", study())


def test_a_task_of_one_participant_has_no_p() -> None:
    assert all(one.p is None or np.isnan(one.p).all() for one in answers(found("0.5,0.2", study()), 1, 3).values())


def test_a_file_states_what_each_material_is_felt_as(tmp_path: Path) -> None:
    file = tmp_path / "pilot.toml"
    of = ", ".join(f'{{ material = "{one.id}", value = {k} }}' for k, one in enumerate(study().materials))
    text = f'format = 1\nsource = "a guess"\nlevel = 0.5\nspread = 0.25\nscatter = 1\nvalues = [{of}]\n'
    file.write_text(text, "utf-8")
    (own,) = found(str(file), without_law()).tasks
    assert own.values.tolist() == [0, 1, 2, 3]
    assert (own.level, own.spread, own.scatter) == (0.5, 0.25, 1.0)


def pilot(root: Path, people: int) -> tuple[Path, RatingModel]:
    protocol = without_law()
    names = tuple(material.id for material in protocol.materials)
    scale = tuple(place.answer for place in protocol.table(Rating).scale)
    whole = found("2,1.5", protocol)
    true = replace(whole, tasks=(Raters("rate", np.array([4.0, 4.5, 5.5, 6.0]), 0.9, 0.6, 1.2),))
    given = draw(true, true.tasks[0], 10, people, 1, np.random.default_rng(5))[0]
    rows = {
        str(who): {"rate": trials((names[m], scale[one]) for m, of in enumerate(own) for one in of.tolist())}
        for who, own in enumerate(given)
    }
    write_dataset(root, rows, study="rating", materials=names, tasks=("rate",), answers=scale, origin="REHEARSAL",
                  kind="presented", design="rating")  # fmt: skip
    return root, true


def test_a_dataset_gives_means_and_how_raters_and_ratings_differ(tmp_path: Path, refuses: Refuses) -> None:
    """A place of the scale is rounded, which adds 1/12 to the variance of single ratings."""
    root, true = pilot(tmp_path / "pilot", 60)
    model = found(str(root), without_law())
    (own,) = model.tasks
    assert own.values == pytest.approx(true.tasks[0].values, abs=0.5)
    assert own.level == pytest.approx(0.9, abs=0.25)
    assert own.spread == pytest.approx(0.6, abs=0.12)
    assert own.scatter == pytest.approx((1.2**2 + 1 / 12) ** 0.5, abs=0.06)
    assert "REHEARSAL" in model.label
    alone, _ = pilot(tmp_path / "alone", 1)
    with refuses(PowerError):
        found(str(alone), without_law())


def test_one_number_of_participants_comes_out(approved: SnapshotAssertion) -> None:
    protocol = study()
    result = simulate.run(
        protocol, planned_tests.design(protocol, {}), found("0.3,0.2", protocol), participants=(4, 10, 25), studies=200,
        seed=1, target=0.8, runner=lambda work, chunks: simulate.on_cores(work, chunks, 1),
    )  # fmt: skip
    assert result.recommended().participants == 25
    assert report.text(result) == approved
