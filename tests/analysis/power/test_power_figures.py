"""The plot of power: legible at the width of a column, and what it shows is what was simulated."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from palpate.analysis.power import report
from palpate.experiment.protocol.models import PlannedTest, Protocol
from tests.analysis.legible import check
from tests.analysis.power.test_power import guess, protocol, run


def _reliability() -> PlannedTest:
    return PlannedTest(test="ICC", tasks=("virtual", "real"), question="?", form="ICC(2,k)")


def _planned(study: Protocol) -> Protocol:
    return study.model_copy(update={"analysis": (*study.analysis, _reliability())})


@pytest.mark.parametrize("sizes", [(15,), (4, 6, 10, 15, 40)])
def test_letters_stand_clear_of_one_another(sizes: tuple[int, ...]) -> None:
    check([report.plot(run(_planned(protocol()), guess(protocol()), participants=sizes))])


def test_long_names_and_many_materials_stand_clear_too() -> None:
    study = protocol()
    named = [study.materials[0].model_copy(update={"id": f"a sheet of thin and crackling foil {n}"}) for n in range(4)]
    pair = tuple(one.id for one in named[:2])
    tests = tuple(one.model_copy(update={"materials": pair if one.materials else ()}) for one in study.analysis)
    renamed = _planned(study.model_copy(update={"materials": tuple(named), "analysis": tests}))
    check([report.plot(run(renamed, guess(study), participants=(4, 15)))])


def test_points_and_bands_are_power_and_its_interval() -> None:
    result = run(protocol(), guess(protocol()), participants=(4, 8, 15))
    questions = [q for q in result.questions if q.test == "t against chance" and q.tasks == ("virtual",)]
    questions = [q for q in questions if not q.adjusted]
    axes = Figure().add_subplot()
    report.powers(axes, result, questions)
    for question, line, band in zip(questions, axes.lines, axes.collections, strict=False):
        rows = [result.row(question, size) for size in (4, 8, 15)]
        assert np.asarray(line.get_ydata()).tolist() == [row.power for row in rows if row]
        drawn = {tuple(point) for point in np.asarray(band.get_paths()[0].vertices).tolist()}
        assert {(row.participants, limit) for row in rows if row for limit in row.interval or ()} <= drawn
    assert {str(text.get_text()) for text in axes.texts} == {"target\n0.8", "alpha\n0.05"}
