"""What a plan shows of third octaves and envelope."""

from __future__ import annotations

from dataclasses import replace

from palpate.experiment.session.kinds.footstep.error_budget import Detailed, ErrorBudget
from palpate.experiment.synthesis.budget import Budget
from palpate.experiment.synthesis.felt import Felt


def test_a_plan_shows_them_of_a_measured_panel_alone() -> None:
    each = (Felt(1.0, 0.25, 0.1, 0.9, (0.0, 2.0), (0.0, 1.0)), Felt(3.5, 0.5, 0.2, 1.0, (2.0, 5.0), (0.0, 1.5)))
    made = Detailed((20.0, 600.0), (Budget(1.0, 0.0),) * 2, (), (), None, None, each)
    plain = replace(made, felt=())
    shown, hidden = (ErrorBudget({"cork": of}, (None, None), None, False, "") for of in (made, plain))
    rows = [line.split()[-3:] for line in shown.lines() if ", dB" in line]
    assert rows == [["1.0", "to", "3.5"], ["2.0", "to", "5.0"], ["0.2", "to", "0.5"], ["1.0", "to", "1.5"]]
    assert [line.split()[-3:] for line in shown.lines() if ", %" in line and "noticed" in line] == [
        ["10", "to", "20"],
        ["90", "to", "100"],
    ]
    assert not any(", dB" in line for line in hidden.lines())
    assert max(map(len, shown.lines())) <= 100
