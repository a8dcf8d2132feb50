"""A rig for vibrations before contact: what is expected of its predictions, and why one is refused."""

from __future__ import annotations

from typing import Any

import pytest

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import Rig, tracker_of
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import Ahead, Protocol
from palpate.experiment.session.kinds.footstep.ahead import refusal
from palpate.experiment.session.kinds.footstep.error_budget import aim_ms
from palpate.experiment.session.kinds.footstep.fidelity import speeds_mm_s


def study(**ahead: Any) -> Protocol:
    shown = files.load(shipped("ahead.toml"))
    contact, before = shown.tasks
    changed = before.model_copy(update={"ahead": Ahead(**ahead)})
    return shown.model_copy(update={"tasks": (contact, changed)})


def rig(noise_mm: float | None = 0.1) -> Rig:
    heard = rigs.load(shipped("rigs/headless.toml"))
    return heard.model_copy(update={"tracker": tracker_of(heard).model_copy(update={"noise_mm": noise_mm})})


def test_the_shipped_study_runs_on_a_rig_whose_noise_is_known() -> None:
    shown = files.load(shipped("ahead.toml"))
    assert refusal(shown, rig()) is None
    unknown = refusal(shown, rig(None))
    assert unknown is not None
    assert unknown.allowed.startswith("8 ms")


def test_an_actuator_that_cannot_be_told_when_to_begin_is_refused() -> None:
    refused = refusal(study(delay_ms=-20), rigs.load(shipped("rigs/rehearsal.toml")))
    assert refused is not None
    assert "audio" in str(refused.remedy)


def test_a_gate_that_leaves_the_rigs_latency_no_time_is_refused() -> None:
    # 15 mm at 300 mm/s are 50 ms, of which the rig takes 8.
    assert refusal(study(delay_ms=-40), rig()) is None
    refused = refusal(study(delay_ms=-45), rig())
    assert refused is not None
    assert "gate_bottom_mm" in str(refused.remedy)


@pytest.mark.parametrize(("noise_mm", "allowed_ms", "runs"), [(0.1, 8.0, True), (0.1, 1.0, False), (1.0, 5.0, False)])
def test_a_rig_is_refused_for_the_largest_error_of_a_speed_that_counts(
    noise_mm: float, allowed_ms: float, runs: bool
) -> None:
    protocol, of = study(delay_ms=-20, error_max_ms=allowed_ms), rig(noise_mm)
    errors_ms = [aim_ms(protocol, of, v, 20.0) or 0.0 for v in speeds_mm_s(protocol)]
    assert (max(errors_ms) <= allowed_ms) == runs == (refusal(protocol, of) is None)


def test_an_earlier_onset_is_predicted_worse() -> None:
    protocol, of = study(delay_ms=-20), rig()
    errors_ms = [aim_ms(protocol, of, 150.0, ahead_ms) or 0.0 for ahead_ms in (0.0, 20.0, 50.0)]
    assert errors_ms == sorted(errors_ms)
    assert errors_ms[2] > 3 * errors_ms[0] > 0
