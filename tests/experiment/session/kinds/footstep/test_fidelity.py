"""What a rig makes of a study's recordings: which speeds count, what is refused, what is printed."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.errors import Finding, RigError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.rehearsal.held import with_refusal
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
from palpate.experiment.session import scene
from palpate.experiment.session.kinds.footstep.error_budget import (
    ASSUMED,
    Detailed,
    ErrorBudget,
    aim_ms,
    detailed,
    error_budget,
)
from palpate.experiment.session.kinds.footstep.fidelity import (
    Fidelity,
    carried_hz,
    causes,
    judged,
    most_left_out,
    refusal,
    speeds_mm_s,
)
from palpate.experiment.session.kinds.footstep.scene_cost import TaskPlan
from palpate.experiment.synthesis.budget import Budget
from tests.approved import Refuses

RIGS = shipped("rigs/rehearsal.toml").parent


@pytest.fixture(scope="module")
def protocol() -> Protocol:
    return files.load(shipped("okamoto2012.toml"))


@pytest.fixture(scope="module")
def recordings(protocol: Protocol, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded_takes.make_recordings(tmp_path_factory.mktemp("made") / "r", protocol=protocol, seed=1).parent


@pytest.fixture(scope="module")
def volts() -> Rig:
    return rigs.load(shipped("rigs/headless.toml"))


@pytest.fixture(scope="module")
def found(protocol: Protocol, recordings: Path, volts: Rig) -> dict[str, Detailed]:
    whole = scene.virtual(protocol)
    return detailed(scene=whole, protocol=protocol, rig=volts, rig_folder=RIGS, recordings=recordings)


def allowing(protocol: Protocol, left_out_max: float | None) -> Protocol:
    synthesis = protocol.table(Footstep).synthesis.model_copy(update={"left_out_max": left_out_max})
    return protocol.model_copy(
        update={"footstep": protocol.table(Footstep).model_copy(update={"synthesis": synthesis})}
    )


def test_the_speeds_are_those_that_the_protocol_counts(protocol: Protocol) -> None:
    speeds = speeds_mm_s(protocol)
    assert [speeds[0], speeds[-1]] == pytest.approx([20.0, 600.0])
    # The spectra bend at the speeds recorded; where most is left out is there, or at an end.
    recorded = protocol.table(Footstep).synthesis.speeds_mm_s
    assert set(recorded) < set(speeds)
    assert np.diff(np.log([v for v in speeds if v not in recorded])) == pytest.approx(np.log(30) / 9)
    # 50 to 300 mm/s were recorded, and nothing says which feet count.
    any_speed = speeds_mm_s(protocol.model_copy(update={"exclusion": ()}))
    assert [any_speed[0], any_speed[-1]] == pytest.approx([50 / 1.5, 450.0])


@pytest.mark.parametrize(("when", "limit"), [("speed-above", 0.0), ("speed-above", 5e-324), ("speed-below", 5e-324)])
def test_an_odd_range_of_speeds_has_its_budget_too(protocol: Protocol, volts: Rig, when: str, limit: float) -> None:
    rules = tuple(
        rule.model_copy(update={"limit": limit}) if rule.when == when else rule for rule in protocol.exclusion
    )
    speeds = speeds_mm_s(protocol.model_copy(update={"exclusion": rules}))
    assert 2 <= len(speeds) <= 14
    assert list(speeds) == sorted(speeds)
    assert all(0 < v <= 600.001 for v in speeds)
    assert aim_ms(protocol, volts, speeds[0]) is None or speeds[0] > 1


def test_the_shipped_rig_leaves_out_what_lies_above_its_table(found: dict[str, Detailed]) -> None:
    assert set(found) == {"copy paper", "aluminum foil", "polypropylene", "typing paper"}
    for of in found.values():
        low, high = of.range(lambda budget: budget.left_out)
        assert 0.11 < low < high < 0.35
        assert all(budget.total >= budget.left_out for budget in of.budgets)
        # Three takes of a random spectrum: each bin's mean has a standard error of 1 / sqrt 3 of its spread.
        assert of.averaging is not None
        assert 0.3 < of.averaging < 0.6
        assert of.interpolation is not None
        assert len(of.other_reading) == len(of.nearest_m_s2) == len(of.speeds_mm_s)
        assert all(0.001 < apart < 0.02 for apart in of.other_reading)


def test_a_rig_is_refused_for_what_no_output_carries(
    protocol: Protocol,
    volts: Rig,
    found: dict[str, Detailed],
    recordings: Path,
    approved: SnapshotAssertion,
    refuses: Refuses,
) -> None:
    carries_hz = carried_hz(volts, RIGS)
    # The ends of the shipped table.
    assert carries_hz == (10.0, 600.0)
    worst = most_left_out([found], carries_hz)
    assert refusal(protocol, volts, worst, carries_hz) is None
    assert refusal(allowing(protocol, 0.35), volts, worst, carries_hz) is None
    # Both ends of the table are at fault, and the lower one more.
    found_of = [refusal(allowing(protocol, most), volts, worst, carries_hz) for most in (0.3, 0.25, 0.2)]
    # What the last digits of a share say differs with the machine's arithmetic.
    assert [re.sub(r"\.\d\d%", ".NN%", one.sentence()) for one in found_of if one is not None] == approved
    with refuses(RigError):
        judged(protocol=allowing(protocol, 0.1), rig=volts, rig_folder=RIGS, recordings=recordings)


def test_a_rig_that_nobody_measured_is_refused_where_there_is_a_limit(
    protocol: Protocol, recordings: Path, approved: SnapshotAssertion, refuses: Refuses
) -> None:
    plain = rigs.load(shipped("rigs/laboratory.toml"))
    given: dict[str, Any] = {"rig": plain, "rig_folder": RIGS, "recordings": recordings}
    assert carried_hz(plain, RIGS) is None
    with refuses(RigError):
        judged(protocol=allowing(protocol, 0.9), **given)
    assert judged(protocol=protocol, **given).partition("; limits")[0] == approved
    measured = plain.actuator.model_copy(update={"low_hz": 10.0, "high_hz": 600.0})
    given["rig"] = plain.model_copy(update={"actuator": measured})
    # As much as the rig in volts, whose table ends there, but for what its gain limit holds back.
    assert re.match(
        r"at most 34\.\d\d% .* at 200",
        judged(protocol=allowing(protocol, 0.35), **given),
    )


def test_a_rig_is_judged_by_what_some_task_presents(
    protocol: Protocol, volts: Rig, found: dict[str, Detailed], recordings: Path
) -> None:
    def presenting(*of: tuple[str, ...] | None) -> Protocol:
        tasks = zip(("virtual", "again"), of, strict=False)
        made = (protocol.task("virtual").model_copy(update={"id": name, "materials": own}) for name, own in tasks)
        return allowing(protocol, 0.3).model_copy(update={"tasks": (*made, protocol.task("real"))})

    given: dict[str, Any] = {"rig": volts, "rig_folder": RIGS, "recordings": recordings}
    worst = {name: max(one.left_out for one in of.budgets) for name, of in found.items()}
    assert worst["copy paper"] > 0.3 > worst["polypropylene"]
    assert "of polypropylene at" in judged(protocol=presenting(("polypropylene",)), **given)
    for fails in (presenting(None), presenting(("polypropylene",), ("copy paper",))):
        with pytest.raises(RigError, match="of copy paper at 200"):
            judged(protocol=fails, **given)
        with pytest.raises(RigError, match="of copy paper at 200"):
            judged(protocol=fails, task_ids=["virtual"], **given)
        # What is refused for one task is refused for the study, whose participants do them all.
        assert "copy paper at 200" in error_budget(task_id="virtual", protocol=fails, **given).refused


def test_without_a_limit_what_is_told_is_of_the_tasks_that_are_asked_for(
    protocol: Protocol, volts: Rig, recordings: Path
) -> None:
    made = [
        protocol.task("virtual").model_copy(update={"id": name, "materials": (material,)})
        for name, material in (("one", "copy paper"), ("two", "polypropylene"))
    ]
    both = protocol.model_copy(update={"tasks": tuple(made)})
    given: dict[str, Any] = {"rig": volts, "rig_folder": RIGS, "recordings": recordings}
    assert "copy paper at 200" in judged(protocol=both, **given)
    assert "copy paper at 200" in judged(protocol=both, task_ids=["two", "one"], **given)
    assert "is left out" in (told := judged(protocol=both, task_ids=["two"], **given))
    assert "copy paper" not in told


def test_what_limits_take_off_most_is_told_of_whichever_scene(approved: SnapshotAssertion) -> None:
    def of(speed_mm_s: float, **shares: float) -> Fidelity:
        return Fidelity((speed_mm_s,), (Budget(1.0, 0.0, **shares),))

    one, two = {"felt": of(20.0, above=0.5)}, {"cork": of(40.0, above=0.1, taken_down=0.25)}
    told = {
        (most.told, most.weaker)
        for found in ([one, two], [two, one], [one | two])
        for most in [most_left_out(found, None)]
    }
    assert len(told) == 1
    assert told.pop() == approved


def test_what_an_inverse_misses_is_told_of_where_nothing_is_left_out(approved: SnapshotAssertion) -> None:
    worse = Budget(1.0, 0.0, inverse=0.178, before=0.012, gain=67.3, gain_hz=10.0)
    of = Fidelity((20.0, 40.0), (Budget(1.0, 0.0, inverse=0.01), worse))
    assert most_left_out([{"felt": of}], (8.9, 563.0)).weaker == approved


def test_a_dead_band_within_the_table_is_what_is_told_of(approved: SnapshotAssertion) -> None:
    dead = Detailed((20.0,), (Budget(1.0, 0.0, above=0.1, held_back=0.3),), (1.0,), (), None, None)
    most = most_left_out([{"felt": dead}], (10.0, 600.0))
    assert most.share == pytest.approx(0.1**0.5)
    ((remedy, share),) = most.remedies
    assert share == 0.3
    assert [most.told, remedy] == approved
    assert most.weaker == ""


def test_the_standard_error_of_contact_is_the_predictors_own(protocol: Protocol, volts: Rig) -> None:
    slow, right, fast = (aim_ms(protocol, volts, v) for v in (20.0, 150.0, 600.0))
    assert slow is not None
    assert right is not None
    assert fast is not None
    assert right < slow
    assert 0.2 < right < 1.2
    # From 10 mm it lands before the onset can be moved.
    assert aim_ms(protocol, volts, 5000.0) is None
    ahead = volts.model_copy(update={"actuator": volts.actuator.model_copy(update={"inverse_ahead_ms": 20.0})})
    assert (aim_ms(protocol, ahead, 150.0) or 0.0) > right
    assert aim_ms(protocol, rigs.load(shipped("rigs/rehearsal.toml")), 150.0) is None


def test_the_table_has_every_cause_and_what_would_lower_it(protocol: Protocol, volts: Rig, recordings: Path) -> None:
    given: dict[str, Any] = {"rig": volts, "rig_folder": RIGS, "recordings": recordings}
    budget = error_budget(task_id="virtual", protocol=allowing(protocol, 0.3), **given)
    text = "\n".join(budget.lines())
    assert budget.carries_hz == (10.0, 600.0)
    for field, name, remedy in causes(budget.carries_hz):
        assert hasattr(next(iter(budget.materials.values())).budgets[0], field)
        # Nothing is inverted here.
        assert bool(re.search(rf"(?m)^  {re.escape(name)}  +[\d<]", text)) == (field != "inverse")
        lowered = field in ("below", "above", "held_back", "taken_down", "table")
        assert (f"{name}: {remedy}" in " ".join(text.split())) == lowered
    assert max(map(len, budget.lines())) <= 100
    assert re.search(r"(?m)^  total +23\.9 to 39\.1 +20\.4 .* 27\.3 +17\.1 .* 24\.9 +11\.2 .* 28\.6$", text)
    assert re.search(r"(?m)^  W interpolated, \(7\) +0\.22 to", text)
    assert "  timing: contact " in text
    assert budget.refused.startswith("rig 'headless': got 34.")
    known = budget.as_dict()
    assert known["refused"] == budget.refused
    assert known["assumes"] == ASSUMED
    materials = known["materials"]
    assert isinstance(materials, dict)
    at_20 = materials["typing paper"]["budgets"][0]
    assert at_20["below"] ** 2 + at_20["above"] ** 2 == pytest.approx(0.1118**2, abs=3e-5)


def test_a_real_rig_whose_response_nobody_measured_is_refused_whatever_it_carries(
    protocol: Protocol, volts: Rig, recordings: Path, approved: SnapshotAssertion
) -> None:
    real = volts.model_copy(update={"rig": volts.rig.model_copy(update={"simulated": False})})
    given: dict[str, Any] = {"protocol": protocol, "rig_folder": RIGS, "recordings": recordings}
    assert not error_budget(task_id="virtual", rig=volts, **given).refused
    refused = error_budget(task_id="virtual", rig=real, **given).refused
    assert refused == approved


def test_a_plan_of_vibrations_refuses_a_panel_that_nobody_measured() -> None:
    silent = Detailed((20.0, 600.0), (Budget(1.0, 0.0),) * 2, (1.0, 2.0), (), None, None)
    planned = TaskPlan("virtual", "Virtual", (), (), ErrorBudget({"felt": silent}, (None, None), None, False, ""))
    finding = Finding("its panel was never measured", "rig.toml")
    assert with_refusal(planned, finding).refused == finding.sentence()
    assert with_refusal(planned, None) == planned
    already = replace(planned, budget=replace(planned.budget, refused="left out"))  # type: ignore[type-var]
    assert with_refusal(already, finding).refused == "left out"
    real = replace(planned, budget=None)
    assert with_refusal(real, finding) == real


def test_what_a_perfect_rig_leaves_is_said_without_advice(approved: SnapshotAssertion) -> None:
    silent = Detailed((20.0, 600.0), (Budget(1.0, 0.0, rounding=1e-8),) * 2, (1.0, 2.0), (), None, None)
    budget = ErrorBudget({"felt": silent}, (None, None), None, schedules=False, refused="")
    lines = budget.lines()
    assert lines == approved
    assert budget.as_dict()["assumes"] is None
    assert "  total                          <0.001" in lines
    after = lines[lines.index("what would lower it") + 1 :]
    assert len(after) == 1


def test_more_materials_than_fit_stand_below_one_another() -> None:
    plain = Detailed((20.0, 600.0), (Budget(1.0, 0.0, table=0.01),) * 2, (1.0, 2.0), (), None, None)
    named = {f"a long material name {i}": plain for i in range(5)}
    lines = ErrorBudget(named, (1.0, 1.0), (10.0, 600.0), schedules=True, refused="").lines()
    assert max(map(len, lines)) <= 100
    assert sum(bool(re.match("  steps of the .*  ", line)) for line in lines) == 3
