"""A stimulus that may still play: what is on record of it, and that nothing is armed meanwhile."""

from __future__ import annotations

from pathlib import Path

import pytest

from palpate.experiment.errors import ActuatorError
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records.entries import Armed, Footer
from palpate.experiment.records.kinds.footstep import BrokenOff
from palpate.experiment.session.kinds.footstep import trials
from tests.experiment.session.bench import Bench, bench, entries, header


@pytest.fixture
def one() -> Bench:
    return bench("ccc")


def test_nothing_is_armed_while_the_last_stimulus_may_still_play(
    one: Bench, protocol: Protocol, tmp_path: Path
) -> None:
    one.actuator.still_plays = True
    with pytest.raises(ActuatorError):
        one.run(protocol, header("virtual"), tmp_path)
    written = entries(tmp_path, "virtual")
    assert not any(isinstance(entry, Armed) for entry in written)
    assert not one.actuator.played
    footer = written[-1]
    assert isinstance(footer, Footer)
    assert (footer.reason, footer.silent) == ("error", False)


def test_a_step_whose_server_failed_states_that_its_stimulus_may_still_play(
    one: Bench, protocol: Protocol, tmp_path: Path
) -> None:
    def fails(contact_ns: int) -> None:
        one.actuator.still_plays = True
        raise ActuatorError("actuator: the server did not close")

    one.actuator.landed = fails  # type: ignore[method-assign]
    with pytest.raises(ActuatorError):
        one.run(protocol, header("virtual"), tmp_path)
    written = entries(tmp_path, "virtual")
    broken = [entry for entry in written if isinstance(entry, BrokenOff)]
    assert [(entry.felt, entry.silent) for entry in broken] == [(True, False)]
    assert sum(isinstance(entry, Armed) for entry in written) == 1
    footer = written[-1]
    assert isinstance(footer, Footer)
    assert footer.silent is False


def test_a_session_that_ends_in_order_is_silent(one: Bench, protocol: Protocol, tmp_path: Path) -> None:
    assert one.run(protocol, header("virtual"), tmp_path).silent is True
    assert bench("ccc").run(protocol, header("real"), tmp_path).silent is None


def test_what_is_silent_in_time_is_waited_for(
    one: Bench, protocol: Protocol, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks: list[int] = []

    def is_silent() -> bool:
        looks.append(one.clock.now_ns())
        return len(looks) > 10

    monkeypatch.setattr(one.actuator, "is_silent", is_silent)
    assert one.run(protocol, header("virtual"), tmp_path).reason == "complete"
    assert looks[9] - looks[0] == 9 * trials.LOOK_NS
