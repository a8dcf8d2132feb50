"""Factors that a file crosses: what they make, that draws balance them, and what is refused."""

from __future__ import annotations

import json
import tomllib
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.protocol.approval import canonical
from palpate.experiment.protocol.designs.factors import crossed
from palpate.experiment.protocol.files import ProtocolFile, load, shipped
from palpate.experiment.protocol.kinds.presented import Presented
from palpate.experiment.protocol.kinds.tapping import Tapping
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.page import page
from palpate.experiment.settings.load import checked, find
from palpate.experiment.study.schedule import schedule
from tests.experiment.protocol.presented import presenting, sited
from tests.experiment.protocol.small import changed, with_tuples

HARDER = shipped("harder.toml").read_text("utf-8")
FREQUENCY, AMPLITUDE = ("factors", 0), ("factors", 1)
STIMULUS = ("presented", "stimuli", 0)
DECAYING = "presented.stimuli[0].parts[0].decaying"


def tables() -> Any:
    """The shipped study of two factors, arrays as tuples."""
    return with_tuples(tomllib.loads(HARDER))


def read(study: Any) -> Protocol:
    return checked(Path("study.toml"), ProtocolFile, study)


def test_each_value_of_a_factor_meets_each_of_the_others() -> None:
    protocol = load(shipped("harder.toml"))
    # Names stand in records and seals: they are the same in every version.
    assert [one.id for one in protocol.materials] == [
        "60 Hz at 2 m/s^2", "60 Hz at 4 m/s^2", "60 Hz at 8 m/s^2",
        "120 Hz at 2 m/s^2", "120 Hz at 4 m/s^2", "120 Hz at 8 m/s^2",
        "240 Hz at 2 m/s^2", "240 Hz at 4 m/s^2", "240 Hz at 8 m/s^2",
    ]  # fmt: skip
    assert crossed(protocol)["120 Hz at 8 m/s^2"] == {"frequency": 120.0, "amplitude": 8.0}
    made = protocol.table(Presented).numbers
    assert {(of["frequency_hz"], of["amplitude_m_s2"], of["decay_per_s"]) for of in made.values()} == {
        (hz, m_s2, 100.0) for hz in (60.0, 120.0, 240.0) for m_s2 in (2.0, 4.0, 8.0)
    }


def test_values_have_names_of_their_own_and_a_sign_stands_behind_the_factors_id() -> None:
    timing = load(shipped("timing.toml"))
    surfaces = {one.material: one.delay_ms for one in timing.table(Tapping).surfaces}
    assert surfaces["20 ms early"] == crossed(timing)["20 ms early"]["delay"] == -20.0
    study = with_tuples(tomllib.loads(shipped("timing.toml").read_text("utf-8")))
    unnamed = read(changed(study, ("factors", 0, "names"), ()))
    assert [one.id for one in unnamed.materials][:3] == ["delay -20 ms", "delay -10 ms", "0 ms"]


@pytest.mark.parametrize("kind", ["blocked-random", "full-random"])
@pytest.mark.parametrize("seed", [1, 2])
def test_draws_balance_every_value_in_both_places(kind: str, seed: int) -> None:
    protocol = read(changed(tables(), ("tasks", 0, "order", "kind"), kind))
    values = crossed(protocol)
    trials = schedule(protocol=protocol, participant="01", task_id="harder", seed=seed)
    for factor in ("frequency", "amplitude"):
        for place in (0, 1):
            counts = Counter(values[one.presented[place]][factor] for one in trials)
            assert set(counts.values()) == {60}
    together = Counter(tuple(values[one.presented[0]].values()) for one in trials)
    assert len(together) == 9
    assert set(together.values()) == {20}


def test_the_canonical_form_has_factors_and_what_they_make() -> None:
    protocol = read(tables())
    assert ProtocolFile.model_validate_json(protocol.model_dump_json()) == protocol
    assert b'"factors":[{"changes":"decaying.frequency_hz"' in canonical(protocol)
    assert canonical(protocol).count(b"240 Hz at 4 m/s^2") == 2
    other = read(changed(tables(), (*AMPLITUDE, "values"), (2.0, 4.0, 7.0)))
    assert canonical(other) != canonical(protocol)


def test_materials_that_participants_name_have_keys_and_stand_beside_others() -> None:
    study = presenting(first=({"sinusoid": {"amplitude_m_s2": 1.0, "lasts_s": 0.25}},))
    del study["presented"]["stimuli"][0]["material"]
    own = study["materials"][1:]
    factor = {"id": "pitch", "changes": "sinusoid.frequency_hz", "values": (50.0, 100.0)}
    protocol = read({**study, "materials": own, "factors": (factor,)})
    assert [one.id for one in protocol.materials] == [*(one["id"] for one in own), "50 Hz", "100 Hz"]
    keys = [one.key for one in protocol.materials]
    assert None not in keys
    assert len(set(keys)) == len(keys)
    assert [one.material for one in protocol.table(Presented).stimuli][-2:] == ["50 Hz", "100 Hz"]


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        ((*FREQUENCY, "changes"), "decaying.frequence_hz", "factors[0]"),
        ((*FREQUENCY, "changes"), "sinusoid.frequency_hz", "factors[0].changes"),
        ((*FREQUENCY, "values"), (60.0,), "factors[0].values"),
        ((*FREQUENCY, "values"), (60.0, 60.0), "factors[0].values[1]"),
        ((*FREQUENCY, "values"), tuple(map(float, range(60, 160))), "factors"),
        ((*FREQUENCY, "names"), ("low", "high"), "factors[0].names"),
        ((*FREQUENCY, "names"), ("low", "low", "high"), "factors"),
        ((*AMPLITUDE, "values"), (2.0, 80.0), "factors[1]"),
        ((*AMPLITUDE, "id"), "frequency", "factors[1].id"),
        ((*AMPLITUDE, "changes"), "decaying.decay_per_s", "presented.stimuli[0].parts[0].decaying.decay_per_s"),
        ((*STIMULUS, "material"), "tap", "factors"),
        ((*STIMULUS, "parts", 0, "decaying", "frequency_hz"), 60.0, f"{DECAYING}.frequency_hz"),
        ((*STIMULUS, "parts", 0, "decaying", "lasts_s"), 90.0, f"{DECAYING}.lasts_s"),
        (("comparison", "ordered"), True, "comparison.ordered"),
    ],
)
def test_what_factors_may_not_be(path: tuple[str | int, ...], value: object, field: str) -> None:
    assert field in {one.field for one in find(ProtocolFile, changed(tables(), path, value), {})}


def test_two_factors_do_not_change_the_same_key() -> None:
    stated = changed(tables(), (*STIMULUS, "parts", 0, "decaying", "amplitude_m_s2"), 4.0)
    twice = changed(stated, (*AMPLITUDE, "changes"), "decaying.frequency_hz")
    assert "factors[1].changes" in {one.field for one in find(ProtocolFile, twice, {})}


def placed() -> dict[str, Any]:
    """A study of amplitudes at sites."""
    study = sited("palm", "wrist")
    del study["materials"]
    amplitude = {"id": "amplitude", "changes": "sinusoid.amplitude_m_s2", "values": (1.0, 2.0)}
    stimulus = {"parts": ({"sinusoid": {"frequency_hz": 100.0, "lasts_s": 0.25}},)}
    return {
        **study,
        "presented": {**study["presented"], "stimuli": (stimulus,)},
        "factors": ({"id": "site", "changes": "site", "names": ("palm", "wrist")}, amplitude),
    }


def test_sites_of_the_body_are_crossed_with_numbers() -> None:
    protocol = read(placed())
    assert protocol.table(Presented).site_of == {
        "palm at 1 m/s^2": "palm",
        "palm at 2 m/s^2": "palm",
        "wrist at 1 m/s^2": "wrist",
        "wrist at 2 m/s^2": "wrist",
    }
    # Only numbers can be regressed on.
    assert crossed(protocol)["wrist at 2 m/s^2"] == {"amplitude": 2.0}
    trials = schedule(protocol=protocol, participant="01", task_id=protocol.tasks[0].id, seed=1)
    at = Counter(protocol.table(Presented).site_of[one.presented[0]] for one in trials)
    assert len(set(at.values())) == 1


def test_sites_alone_are_no_numbers() -> None:
    study = placed()
    stimulus = changed(study, (*STIMULUS, "parts", 0, "sinusoid", "amplitude_m_s2"), 2.0)
    protocol = read({**stimulus, "factors": study["factors"][:1]})
    assert [one.id for one in protocol.materials] == ["palm", "wrist"]
    assert crossed(protocol) == {}


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        ((*FREQUENCY, "values"), (1.0, 2.0), "factors[0].values"),
        ((*FREQUENCY, "names"), ("palm",), "factors[0].values"),
        ((*FREQUENCY, "names"), ("palm", "toe"), "factors[0]"),
        ((*AMPLITUDE, "values"), (1.0, 4.75), "factors[1]"),
        ((*STIMULUS, "site"), "palm", "presented.stimuli[0].site"),
    ],
)
def test_a_factor_of_sites_has_those_of_the_study(path: tuple[str | int, ...], value: object, field: str) -> None:
    found = {one.field for one in find(ProtocolFile, changed(placed(), path, value), {})}
    assert any(one is not None and one.startswith(field) for one in found)


@pytest.mark.parametrize(
    ("key", "value", "field"),
    [
        ("frequency_hz", 60.0, None),
        ("frequency_hz", 333.0, f"{DECAYING}.frequency_hz"),
        ("lasts_s", 0.2, "presented.stimuli[1]"),
    ],
)
def test_stimuli_that_are_spelled_out_are_as_their_factors_make_them(key: str, value: float, field: str | None) -> None:
    whole = with_tuples(json.loads(read(tables()).model_dump_json()))
    spelled = changed(whole, (*STIMULUS, "parts", 0, "decaying", key), value)
    assert [one.field for one in find(ProtocolFile, spelled, {})][:1] == ([field] if field else [])


def test_a_study_without_an_order_has_no_levels() -> None:
    levels = {"method": "constant", "grid": (0.5, 1.0)}
    leveled = changed(tables(), ("tasks", 0, "levels"), levels)
    assert "tasks[0].levels" in {one.field for one in find(ProtocolFile, leveled, {})}


def test_the_page_shows_what_factors_set(snapshot: SnapshotAssertion) -> None:
    shown = [page(load(shipped(name)), name).partition("\n6. ")[2].partition("\n7. ")[0] for name in
             ("harder.toml", "late.toml")]  # fmt: skip
    assert "\n".join(shown) == snapshot
