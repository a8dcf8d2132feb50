"""What `palpate doctor` calls a part that fails while it is looked at, and one that fails as it is closed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest

from palpate.experiment.apparatus import opening, rig
from palpate.experiment.apparatus.audio import calibration
from palpate.experiment.apparatus.doctor import devices, doctor
from palpate.experiment.errors import AudioError, Finding, PalpateError, TrackerError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.clock import ManualClock

RIG = rig.load(shipped("rigs/headless.toml"))
ENDS = doctor.SimulatedPorts(port="nowhere")


class Part:
    """A tracker or a stream; one part of it fails."""

    rate_hz = 48_000

    def __init__(self, failing: str, error: PalpateError) -> None:
        self._failing, self._error = failing, error

    @property
    def health(self) -> None:
        self._fails("health")

    def close(self) -> None:
        self._fails("close")

    def _fails(self, part: str) -> None:
        if part == self._failing:
            raise self._error


def red(checks: Iterator[Finding]) -> list[Finding]:
    return [check for check in checks if check.verdict == "refuses"]


def test_what_a_study_asks_for_and_the_rig_has_nothing_for_is_told_and_not_red() -> None:
    study = files.load(shipped("okamoto2012.toml"))
    listens = study.model_copy(update={"answers": study.answers.model_copy(update={"microphone": True})})
    assert any(rule.when == "undelivered" for rule in study.exclusion)
    bare = RIG.model_copy(update={"audio": None})
    found = list(doctor._elsewhere(bare, listens))
    assert [(check.check, check.verdict) for check in found] == [
        ("masker", "unknown"),
        ("microphone", "unknown"),
        ("undelivered", "unknown"),
    ]
    assert found[0].what.endswith("by other means")
    whole = rig.load(shipped("rigs/laboratory.toml"))
    assert [check.check for check in doctor._elsewhere(whole, listens)] == ["microphone"]
    assert [*doctor._elsewhere(whole, study), *doctor._elsewhere(bare, None)] == []


@pytest.mark.parametrize(("failing", "name"), [("checks", "tracker"), ("close", "tracker closing")])
def test_a_tracker_that_fails_is_named_by_what_failed(monkeypatch: pytest.MonkeyPatch, failing: str, name: str) -> None:
    error = TrackerError("tracker", "got no device", "see to it")
    part = Part(failing, error)

    def checks(device: Part, *_: object, **__: object) -> tuple[Finding, ...]:
        device._fails("checks")
        return ()

    monkeypatch.setattr(opening, "open_tracker", lambda *_, **__: part)
    monkeypatch.setattr(devices, "checks", checks)
    assert red(doctor._tracker(RIG, ENDS, ManualClock(0))) == [replace(error.finding, check=name)]


@pytest.mark.parametrize(("failing", "name"), [("health", "audio stream"), ("close", "audio closing")])
def test_audio_that_fails_is_named_by_what_failed_and_the_tracker_is_looked_at_all_the_same(
    monkeypatch: pytest.MonkeyPatch, failing: str, name: str
) -> None:
    error = AudioError("audio", "the stream broke", "start again")
    part = Part(failing, error)
    monkeypatch.setattr(calibration, "open_probing", lambda *_, **__: part)
    monkeypatch.setattr(opening, "open_tracker", lambda *_, **__: Part("", TrackerError("")))
    for module, check in ((devices, "checks"), (devices, "steady"), (devices, "loopback")):
        monkeypatch.setattr(module, check, lambda *_, **__: ())
    assert RIG.audio is not None
    found = list(doctor._audio(RIG, RIG.audio, RIG.views, ENDS, ManualClock(0)))
    assert red(iter(found)) == [replace(error.finding, check=name)]
    assert "tracker port" in [check.check for check in found]
