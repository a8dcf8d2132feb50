"""What `palpate doctor` finds of an accelerometer, in windows and at a port; the table is `benchmarks/sensors`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from palpate.experiment.apparatus.doctor import sensor
from palpate.experiment.apparatus.panel.accelerometer import Window
from tests.benchmarks import sensors
from tests.benchmarks.drift import RATE_HZ, Memory
from tests.benchmarks.limit import ONE_MODE

QUIET = Window(np.random.default_rng(1).normal(0.0, 0.002, RATE_HZ), 0)


@pytest.mark.parametrize(
    ("window", "took_s", "red"),
    [
        (QUIET, 1.0, []),
        (QUIET, 0.5, ["accelerometer rate"]),
        (QUIET, 2.0, ["accelerometer rate"]),
        (replace(QUIET, samples_m_s2=np.full(RATE_HZ, 0.01)), 1.0, ["accelerometer at rest"]),
        (replace(QUIET, samples_m_s2=100 * QUIET.samples_m_s2), 1.0, ["accelerometer at rest"]),
    ],
)
def test_a_sensor_at_rest_is_quiet_at_its_rate_and_not_dead(window: Window, took_s: float, red: list[str]) -> None:
    found = sensor.heard(window, sensors.SETTINGS, took_s=took_s)
    assert [one.check for one in found if one.verdict == "refuses"] == red


def test_an_address_of_another_device_is_red_on_either_side(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("palpate.experiment.apparatus.panel.accelerometer.ALIVE_S", 0.05)
    for found in (
        sensors.shared(1),
        sensors.listened(sensors.nothing, 1),
        sensors.played_to(1, sensors.noise),
    ):
        assert [one.verdict for one in found] == ["refuses"]


def test_a_sensor_that_sends_no_numbers_is_red(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensor, "LISTEN_S", 0.1)
    assert [one.verdict for one in sensors.listened(sensors.nan, 1)] == ["refuses"]


@pytest.mark.parametrize(("kind", "found"), [(Memory, 0), (sensors.Elsewhere, 1), (sensors.Dead, 1)])
def test_a_session_finds_a_sensor_that_hears_another_panel(kind: type[Memory], found: int) -> None:
    """The other panel is alike, and moves as much at each frequency."""
    assert sensors.refused_before_a_session(ONE_MODE, kind, 1) == found
