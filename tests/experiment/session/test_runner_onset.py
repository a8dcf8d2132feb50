"""The runner's stimuli: aimed, withdrawn, undelivered and failing, with scripted devices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from palpate.experiment.apparatus.tracker.frames import Samples
from palpate.experiment.apparatus.tracker.landing import STOPPED
from palpate.experiment.desk.questions import INTERRUPTED
from palpate.experiment.errors import ActuatorError, AudioError, PalpateError, TrackerError
from palpate.experiment.protocol.models import Ahead, Protocol
from palpate.experiment.records.entries import Footer, Redo
from palpate.experiment.records.kinds.footstep import BrokenOff, FootStep
from palpate.experiment.records.stimulus import Delivered
from palpate.experiment.session import runner
from tests.experiment.session.bench import DELIVERED, bench, entries, felt_and_on_file, header, in_pieces
from tests.experiment.session.scripted import START_NS, step_samples


def joined(*parts: Samples) -> Samples:
    """One read of several."""
    raw = b"".join(part.raw for part in parts)
    begins = np.cumsum([0, *(len(part.raw) for part in parts[:-1])])
    return Samples(
        np.concatenate([part.device_us for part in parts]),
        np.concatenate([part.height_mm for part in parts]),
        raw,
        np.concatenate([begin + part.ends for begin, part in zip(begins, parts, strict=True)]),
        parts[-1].arrived_ns,
    )


def in_vain(start_us: int, speed_mm_s: float) -> Samples:
    """A foot that comes down from 30 mm, stops 5 mm above the panel for 0.2 s, and goes back up."""
    fall_s = 25 / speed_mm_s
    seconds = np.arange(0, fall_s + 0.5, 1e-3)
    height = np.interp(seconds, [0, fall_s, fall_s + 0.2, fall_s + 0.4], [30, 5, 5, 30])
    device_us = np.rint(start_us + seconds * 1e6).astype(np.int64)
    return Samples(device_us, height, bytes(len(seconds)), np.arange(len(seconds)) + 1, START_NS)


@pytest.mark.parametrize("pieces", [1, 7, 100])
def test_a_foot_that_stops_plays_nothing_and_the_trial_is_armed_again_while_it_is_watched(
    protocol: Protocol, tmp_path: Path, pieces: int
) -> None:
    # Nothing between the two is thrown away, however the reads were cut.
    rest = joined(in_vain(2_000_000, 150.0), step_samples(3_000_000, 100.0))
    steps = []
    for n in np.array_split(np.arange(rest.device_us.size), pieces):
        piece, rest = rest.cut(n.size)
        steps.append(piece)
    one = bench("cpt", [*steps, step_samples(5_000_000, 150.0), step_samples(7_000_000, 150.0)])
    assert one.run(protocol, header("virtual"), tmp_path) == Footer(reason="complete", answered=3, silent=True)
    assert one.console.armed == [(1, 1), (2, 1), (3, 1)]
    assert one.console.rearmed == [(1, 2, STOPPED)]
    assert [speed for _, speed in one.rendered] == pytest.approx([150.0, 100.0, 150.0, 150.0], rel=1e-6)
    assert len(one.actuator.played) == 3
    assert one.actuator.withdrawn == 1
    done = entries(tmp_path, "virtual")
    (broken,) = [e for e in done if isinstance(e, BrokenOff)]
    assert (broken.trial, broken.attempt, broken.felt) == (1, 1, False)
    assert broken.speed_mm_s == pytest.approx(150.0, rel=1e-6)
    stopped_us = 2_000_000 + 25e6 / 150
    assert broken.at_us is not None
    assert stopped_us < broken.at_us < stopped_us + 60_000
    first = next(e for e in done if isinstance(e, FootStep))
    assert (first.attempt, first.trace.offset) == (2, broken.trace.length)
    assert broken.at_us == 2_000_000 + 1000 * (broken.trace.length - 1)


def test_what_can_no_longer_be_withdrawn_has_its_trial_put_off(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt", [in_vain(2_000_000, 150.0), *(step_samples(2_000_000 * n, 150.0) for n in range(2, 6))])
    one.actuator.sounds_anyway = True
    assert one.run(protocol, header("virtual"), tmp_path) == Footer(reason="complete", answered=3, silent=True)
    assert one.console.armed == [(1, 1), (2, 1), (3, 1), (1, 2)]
    assert one.console.rearmed == []


def beginning(protocol: Protocol, ahead: Ahead) -> Protocol:
    """The study with a virtual task whose vibration begins before contact."""
    tasks = tuple(
        task.model_copy(update={"ahead": ahead if task.stimulus == "virtual" else None}) for task in protocol.tasks
    )
    return protocol.model_copy(update={"tasks": tasks})


@pytest.mark.parametrize(("lead_ms", "delay_ms"), [(6, -20.0), (12, -20.0), (6, -45.0)])
def test_the_onset_is_aimed_as_long_before_contact_as_the_protocol_has_it(
    protocol: Protocol, tmp_path: Path, lead_ms: int, delay_ms: float
) -> None:
    one = bench("cpt", [piece for n in range(1, 4) for piece in in_pieces(step_samples(2_000_000 * n, 150.0))])
    one.actuator.lead_ns = lead_ms * 1_000_000
    study = beginning(protocol, Ahead(delay_ms=delay_ms))
    assert one.run(study, header("virtual"), tmp_path).answered == 3
    steps = [e for e in entries(tmp_path, "virtual") if isinstance(e, FootStep)]
    for step, aimed in zip(steps, one.actuator.aimed, strict=True):
        onset = step.onset
        assert onset is not None
        assert onset.predicted_us is not None
        assert onset.predicted_from_us is not None
        assert onset.prediction_error_ms is not None
        assert (onset.ahead_ms, onset.scheduled_ns) == (-delay_ms, aimed[-1])
        assert -0.1 < (onset.predicted_us - onset.predicted_from_us) / 1e3 + delay_ms - lead_ms < 1.1
        # A steady foot is where it was expected, and the onset is off by what its contact was.
        assert abs(onset.prediction_error_ms) < 1.5
        assert onset.off_ms == pytest.approx(onset.prediction_error_ms, abs=1e-5)


def test_a_step_that_breaks_off_before_contact_gets_no_vibration(protocol: Protocol, tmp_path: Path) -> None:
    feet = [in_vain(2_000_000, 150.0), *(step_samples(2_000_000 * n, 150.0) for n in range(2, 5))]
    one = bench("cpt", [piece for foot in feet for piece in in_pieces(foot)])
    one.actuator.lead_ns = 5_000_000
    one.run(beginning(protocol, Ahead(delay_ms=-20)), header("virtual"), tmp_path)
    (broken,) = [e for e in entries(tmp_path, "virtual") if isinstance(e, BrokenOff)]
    assert (broken.felt, broken.stimulus, broken.begun) == (False, None, None)
    assert one.console.rearmed == [(1, 2, STOPPED)]
    assert len(one.actuator.played) == 3


@pytest.mark.parametrize("has_begun", [True, False], ids=["it has begun", "the protocol plays it"])
def test_what_a_broken_step_let_be_felt_is_on_record_and_repeated(
    protocol: Protocol, tmp_path: Path, has_begun: bool
) -> None:
    feet = [in_vain(2_000_000, 150.0), *(step_samples(2_000_000 * n, 150.0) for n in range(2, 6))]
    one = bench("cpt", [piece for foot in feet for piece in in_pieces(foot)])
    one.actuator.lead_ns, one.actuator.sounds_anyway = 5_000_000, has_begun
    ahead = Ahead(delay_ms=-20, broken_off="nothing" if has_begun else "vibration")
    one.run(beginning(protocol, ahead), header("virtual"), tmp_path)
    assert one.console.armed == [(1, 1), (2, 1), (3, 1), (1, 2)]
    done = entries(tmp_path, "virtual")
    (broken,) = [e for e in done if isinstance(e, BrokenOff)]
    assert broken.felt
    assert broken.stimulus is not None
    assert broken.begun is not None
    assert broken.begun.scheduled_ns == one.actuator.aimed[0][-1]
    steps = [e for e in done if isinstance(e, FootStep)]
    assert broken.felt_s == steps[0].felt_s
    assert one.actuator.withdrawn == has_begun


def test_a_step_whose_vibration_misses_its_time_by_more_than_allowed_is_repeated(
    protocol: Protocol, tmp_path: Path
) -> None:
    one = bench("cpt", [piece for n in range(1, 5) for piece in in_pieces(step_samples(2_000_000 * n, 150.0))])
    one.actuator.lead_ns = 5_000_000
    # The first cannot be scheduled, so that it sounds at contact.
    one.actuator.late = {1}
    ahead = Ahead(delay_ms=-20, error_max_ms=5)
    assert one.run(beginning(protocol, ahead), header("virtual"), tmp_path).reason == "complete"
    assert one.console.armed == [(1, 1), (2, 1), (3, 1), (1, 2)]
    (redone,) = [e for e in entries(tmp_path, "virtual") if isinstance(e, Redo)]
    assert redone.reason.startswith("ahead: ")


@pytest.mark.parametrize("lead_ms", [5, 6, 7, 12])
def test_the_onset_is_aimed_at_the_predicted_contact_until_it_cannot_be_moved(
    protocol: Protocol, tmp_path: Path, lead_ms: int
) -> None:
    steps = [step_samples(2_000_000 * n, 150.0) for n in range(1, 4)]
    one = bench("cpt", [piece for step in steps for piece in (*in_pieces(step),)])
    one.actuator.lead_ns = lead_ms * 1_000_000
    one.run(protocol, header("virtual"), tmp_path)
    for step, aimed in zip(
        (e for e in entries(tmp_path, "virtual") if isinstance(e, FootStep)), one.actuator.aimed, strict=True
    ):
        onset = step.onset
        assert onset is not None
        assert onset.predicted_us is not None
        assert onset.predicted_from_us is not None
        assert onset.prediction_error_ms is not None
        # The steady foot of 150 mm/s; the filter supposes noise of 0.1 mm, so it believes its prior a little.
        assert abs(onset.prediction_error_ms) < 0.5
        assert lead_ms <= (onset.predicted_us - onset.predicted_from_us) / 1e3 < lead_ms + 1.1
        assert onset.prediction_error_ms == (onset.predicted_us - step.contact_us) / 1e3
        assert step.contact_standard_error_ms is not None
        assert onset.standard_error_ms is not None
        assert 0 < step.contact_standard_error_ms < onset.standard_error_ms
        assert onset.scheduled_ns == aimed[-1]
        assert onset.scheduled_ns - onset.contact_ns == pytest.approx(onset.prediction_error_ms * 1e6, abs=2)
        assert len(aimed) > 10


def test_where_nothing_can_be_scheduled_the_prediction_is_journaled_alone(protocol: Protocol, tmp_path: Path) -> None:
    bench("cpt").run(protocol, header("virtual"), tmp_path)
    for step in (e for e in entries(tmp_path, "virtual") if isinstance(e, FootStep)):
        assert step.onset is not None
        assert (step.onset.scheduled_ns, step.onset.delivered) == (None, None)
        assert step.onset.predicted_us == pytest.approx(step.contact_us, abs=200)


@pytest.mark.parametrize("block", [3, 1])
def test_an_undelivered_trial_is_repeated_at_the_end_of_its_block(
    protocol: Protocol, tmp_path: Path, block: int
) -> None:
    one = bench("cpt", [step_samples(2_000_000 * n, 150.0) for n in range(1, 5)])
    one.actuator.heard.extend([DELIVERED.model_copy(update={"delivered": False, "reason": "nothing was heard"})])
    asked = header("virtual").model_copy(update={"block_trials": block})
    assert one.run(protocol, asked, tmp_path) == Footer(reason="complete", answered=3, silent=True)
    assert one.console.armed == ([(1, 1), (2, 1), (3, 1), (1, 2)] if block == 3 else [(1, 1), (1, 2), (2, 1), (3, 1)])
    (redone,) = [e for e in entries(tmp_path, "virtual") if isinstance(e, Redo)]
    assert redone.reason.startswith("undelivered: ")


@pytest.mark.parametrize("between", [DELIVERED, None], ids=["delivered", "not measured"])
def test_a_rig_that_delivers_nothing_pauses_the_session(
    protocol: Protocol, tmp_path: Path, between: Delivered | None
) -> None:
    failed = DELIVERED.model_copy(update={"delivered": False, "reason": "nothing was heard"})
    one = bench("ccppp", [step_samples(600_000 * n, 100.0) for n in range(1, 4 + runner.MOST_UNDELIVERED)])
    one.actuator.heard.extend([failed] * 2 + [between] + [failed] * runner.MOST_UNDELIVERED)
    footer = one.run(protocol, header("virtual"), tmp_path)
    detail = (
        f"the stimulus was not delivered in {runner.MOST_UNDELIVERED} attempts in a row; "
        "run palpate doctor --rig RIG, then resume"
    )
    assert footer == Footer(reason="paused", detail=detail, answered=1, silent=True)
    assert len(one.console.armed) == 3 + runner.MOST_UNDELIVERED
    assert entries(tmp_path, "virtual")[-1] == footer
    second = bench("cpn")
    assert second.run(protocol, header("virtual"), tmp_path).reason == "complete"


def test_without_a_rule_an_undelivered_trial_is_marked_and_counts(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt")
    one.actuator.heard.append(DELIVERED.model_copy(update={"delivered": False, "reason": "nothing was heard"}))
    kept = tuple(rule for rule in protocol.exclusion if rule.when != "undelivered")
    one.run(protocol.model_copy(update={"exclusion": kept}), header("virtual"), tmp_path)
    first = next(e for e in entries(tmp_path, "virtual") if isinstance(e, FootStep))
    assert first.onset is not None
    assert first.onset.delivered is not None
    assert first.onset.delivered.reason == "nothing was heard"


@pytest.mark.parametrize("failed", [AudioError("audio: the stream has stopped"), ActuatorError("actuator: gone")])
def test_a_step_that_was_felt_is_on_file_when_the_sound_fails_after_contact(
    protocol: Protocol, tmp_path: Path, failed: PalpateError
) -> None:
    one = bench("c")
    one.actuator.heard.append(failed)
    with pytest.raises(type(failed), match=str(failed)):
        one.run(protocol, header("virtual"), tmp_path)
    *_, broken, footer = entries(tmp_path, "virtual")
    assert footer == Footer(reason="error", detail=str(failed), answered=0, silent=True)
    felt_and_on_file(broken, str(failed), tmp_path)
    second = bench("pnc")
    assert second.run(protocol, header("virtual"), tmp_path).reason == "complete"
    assert second.console.armed == [(2, 1), (3, 1), (1, 2)]


def test_a_step_that_was_felt_is_on_file_when_it_is_interrupted(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("c")
    one.actuator.heard.append(KeyboardInterrupt())
    footer = one.run(protocol, header("virtual"), tmp_path)
    assert footer == Footer(reason="paused", detail=INTERRUPTED, answered=0, silent=True)
    *_, broken, last = entries(tmp_path, "virtual")
    assert last == footer
    felt_and_on_file(broken, "interrupted at the keyboard", tmp_path)
    second = bench("pnc")
    assert second.run(protocol, header("virtual"), tmp_path).reason == "complete"
    assert second.console.armed == [(2, 1), (3, 1), (1, 2)]


def test_a_stimulus_is_withdrawn_when_the_session_breaks_off(protocol: Protocol, tmp_path: Path) -> None:
    falling, _ = step_samples(2_000_000, 150.0).cut(180)
    one = bench("c", [falling, TrackerError("the device restarted")])
    with pytest.raises(TrackerError, match="the device restarted"):
        one.run(protocol, header("virtual"), tmp_path)
    assert (one.actuator.played, one.actuator.withdrawn) == ([], 1)


def test_what_follows_contact_in_the_same_read_is_another_step(protocol: Protocol, tmp_path: Path) -> None:
    first, second = step_samples(2_000_000, 150.0), step_samples(2_600_000, 300.0)
    one = bench("cpt", [joined(first, second), step_samples(4_000_000, 150.0), step_samples(6_000_000, 150.0)])
    one.run(protocol, header("virtual"), tmp_path)
    assert [speed for _, speed in one.rendered] == pytest.approx([150.0] * 3, rel=1e-6)
