"""What a protocol of presented stimuli may say."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest

from palpate.experiment.protocol.designs import NAMES, design_of
from palpate.experiment.protocol.files import ProtocolFile, load, shipped
from palpate.experiment.protocol.kinds.presented import KIND, Presented
from palpate.experiment.records.events import PLACES
from palpate.experiment.settings.load import find
from tests.experiment.protocol.presented import RECORDED, presenting, sited
from tests.experiment.protocol.small import changed, with_tuples


def study() -> Any:
    """The shipped study as tables with arrays as tuples."""
    return with_tuples(tomllib.loads(shipped("presented.toml").read_text("utf-8")))


def test_the_shipped_study_declares_a_stimulus_for_each_material() -> None:
    protocol = load(shipped("presented.toml"))
    declared = protocol.table(Presented).stimuli
    assert [(one.material, one.lasts_s) for one in declared] == [(one.id, 0.5) for one in protocol.materials]
    assert protocol.gate is None


FIRST, THIRD = ("presented", "stimuli", 0), ("presented", "stimuli", 2)
PART, NOISE = "presented.stimuli[0].parts[0]", "presented.stimuli[2].parts[0].noise"


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        (("tasks", 0, "stimulus"), "real", "tasks[0].stimulus"),
        ((*FIRST, "material"), "hum", "presented.stimuli[0].material"),
        (
            (*FIRST, "parts", 0, "sinusoid", "amplitude_m_s2"),
            15.5,
            f"{PART}.sinusoid.amplitude_m_s2",
        ),
        ((*FIRST, "parts", 0, "ramp_s"), 0.3, f"{PART}.ramp_s"),
        ((*FIRST, "parts", 0, "silence"), {"lasts_s": 1.0}, f"{PART}.silence"),
        (
            (*THIRD, "parts", 0, "noise", "high_hz"),
            40.0,
            f"{NOISE}.high_hz",
        ),
        (("exclusion", 0, "when"), "frames-lost", "exclusion[0].when"),
    ],
)
def test_what_it_may_not_say(path: tuple[str | int, ...], value: object, field: str) -> None:
    assert field in {one.field for one in find(ProtocolFile, changed(study(), path, value), {})}


def test_a_pause_is_stated_where_a_trial_presents_several() -> None:
    paired = changed(study(), ("tasks", 0, "design"), "comparison")
    assert "presented.pause_s" in {one.field for one in find(ProtocolFile, paired, {})}
    assert "presented.pause_s" not in {one.field for one in find(ProtocolFile, study(), {})}


def test_a_file_that_is_named_twice_has_one_hash() -> None:
    one = {"recorded": {**RECORDED["recorded"], "sha256": "1" * 64}}
    (found,) = find(ProtocolFile, presenting(first=(RECORDED, one)), {})
    assert found.field.endswith("parts[1].recorded.sha256")
    assert not find(ProtocolFile, presenting(first=(RECORDED, RECORDED)), {})


SITE = ("presented", "sites", 0)


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        ((*SITE, "name"), "wrist", "presented.sites[1].name"),
        ((*SITE, "name"), "toe", "presented.sites[0].name"),
        ((*SITE, "name"), "toe", "presented.stimuli[0].site"),
        ((*SITE, "peak_m_s2"), 99.0, "presented.sites[0].peak_m_s2"),
        ((*SITE, "peak_m_s2"), 2.5, f"{PART}.sinusoid.amplitude_m_s2"),
        ((*FIRST, "site"), None, "presented.stimuli[0].site"),
        (("presented", "sites"), (), "presented.stimuli[0].site"),
    ],
)
def test_sites_of_the_body_are_those_of_the_stimuli_each_with_its_limit(
    path: tuple[str | int, ...], value: object, field: str
) -> None:
    right = sited("palm", "wrist")
    assert not find(ProtocolFile, right, {})
    assert field in {one.field for one in find(ProtocolFile, changed(right, path, value), {})}


def test_a_trial_presents_no_more_than_some_design_asks_about() -> None:
    asked = {shown for name in NAMES for shown in design_of(name).intervals}
    assert set(KIND.intervals) == asked
    assert len(PLACES) == max(asked)
