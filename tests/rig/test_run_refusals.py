"""`palpate run` refuses a rig that is not in order before anybody is on the panel: no journal is begun."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterator
from datetime import date, timedelta
from hashlib import sha256
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel.validity import CALIBRATE
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.tracker.serial_tracker import SerialTracker
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
from palpate.experiment.rehearsal.wires.foot import Foot
from palpate.experiment.rehearsal.wires.panel import Panel
from palpate.experiment.rehearsal.wires.serial_line import SerialLine
from tests.approved import on_any_machine
from tests.conftest import Palpate
from tests.rig import sound
from tests.rig.laboratory import write_rig

SETTINGS = tracker_of(rigs.load(shipped("rigs/rehearsal.toml")))

Run = Callable[[Path], str]


@pytest.fixture
def stated() -> str:
    """What the protocol says of synthesis besides."""
    return ""


@pytest.fixture
def refusal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, palpate: Palpate, seed_for: Callable[[Path, str], int], stated: str
) -> Run:
    """Runs a session of a sealed study with a rig file, which must be refused in one line; returns that line."""
    monkeypatch.chdir(tmp_path)
    study = tmp_path / "study.toml"
    text = shipped("okamoto2012.toml").read_text("utf-8")
    study.write_text(text.replace('average = "magnitude"', f'average = "magnitude"\n{stated}', 1), "utf-8")
    manifest = recorded_takes.make_recordings(tmp_path / "recordings", protocol=files.load(study), seed=1)
    manifest.write_text(manifest.read_text("utf-8").replace("simulated = true", "simulated = false"), "utf-8")
    today = date.today()
    approval = ["--approved-on", today, "--expires-on", today + timedelta(9)]
    assert palpate("seal", study, "--approval-number", "17", *approval)[0] == 0
    consent = ["--consent-on", today, "--dataset", "dataset", "--seed", seed_for(study, "virtual")]
    assert palpate("enrol", study, "-p", "01", *consent)[0] == 0

    def asked(prompt: str) -> str:
        raise AssertionError(f"the experimenter was asked: {prompt}")

    monkeypatch.setattr("builtins.input", asked)

    def run(rig: Path) -> str:
        where = ["--rig", rig, "--dataset", "dataset", "--recordings", "recordings"]
        code, _, err = palpate("run", study, "-p", "01", "--task", "virtual", *where)
        assert code == 2, err
        assert err.count("\n") == 1
        assert not list(tmp_path.glob("dataset/sourcedata/sub-01/*"))
        return err

    return run


@pytest.fixture
def panel() -> Iterator[Panel]:
    opened = Panel(rigs.load(shipped("rigs/rehearsal.toml")).actuator)
    yield opened
    opened.close()


def test_a_busy_or_silent_port(
    line: SerialLine, panel: Panel, refusal: Run, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    rig = write_rig(tmp_path, "rehearsal", port=f'"{line.url}"', address=f'"{panel.address}"')
    assert on_any_machine(refusal(rig), tmp_path) == approved
    holder = SerialTracker(line.url, SETTINGS)
    assert on_any_machine(refusal(rig), tmp_path) == approved
    holder.close()
    assert panel.felt(0) is None


def test_the_session_of_another_participant_is_named_as_what_has_the_devices(
    line: SerialLine, panel: Panel, refusal: Run, palpate: Palpate, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    rig = write_rig(tmp_path, "rehearsal", port=f'"{line.url}"', address=f'"{panel.address}"')
    consent = ["--consent-on", date.today(), "--dataset", "dataset"]
    assert palpate("enrol", "study.toml", "-p", "02", *consent)[0] == 0
    holder = SerialTracker(line.url, SETTINGS)
    with journal.locked(tmp_path / "dataset" / "sourcedata" / "sub-02", "02"):
        told = refusal(rig)
    holder.close()
    assert on_any_machine(told, tmp_path) == approved


@pytest.mark.parametrize("stated", ["left_out_max = 0.3"], ids=["stated"])
def test_a_rig_that_leaves_out_more_than_the_protocol_allows(
    refusal: Run, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    """The shipped response reaches from 10 to 600 Hz. Nothing is opened, and no recordings are kept."""
    told = refusal(write_rig(tmp_path, "rehearsal", port='"nowhere"', address='"127.0.0.1:9"'))
    assert on_any_machine(told, tmp_path) == approved
    assert not (tmp_path / "dataset" / "sourcedata" / "recordings").exists()


def test_a_response_that_nobody_measured(refusal: Run, tmp_path: Path, approved: SnapshotAssertion) -> None:
    rig = write_rig(tmp_path, "rehearsal", port='"nowhere"', address='"127.0.0.1:9"')
    table = shipped("rigs/rehearsal-response.csv").read_bytes()
    (tmp_path / "rehearsal-response.csv").write_bytes(table)
    text = re.sub('response_sha256 = "[0-9a-f]+"', f'response_sha256 = "{sha256(table).hexdigest()}"', rig.read_text())
    rig.write_text(text, "utf-8")
    assert on_any_machine(refusal(rig), tmp_path) == approved


def test_counts_outside_the_calibration(
    line: SerialLine, panel: Panel, refusal: Run, tmp_path: Path, approved: SnapshotAssertion
) -> None:
    rig = write_rig(tmp_path, "rehearsal", port=f'"{line.url}"', address=f'"{panel.address}"')
    foot = Foot(line, SETTINGS, real_time=True, rest_mm=150.0)
    assert on_any_machine(refusal(rig), tmp_path) == approved
    foot.close()


def test_an_address_where_nothing_answers(line: SerialLine, refusal: Run, tmp_path: Path) -> None:
    nobody = Panel(rigs.load(shipped("rigs/rehearsal.toml")).actuator)
    nobody.close()
    rig = write_rig(tmp_path, "rehearsal", port=f'"{line.url}"', address=f'"{nobody.address}"')
    assert f"actuator at {nobody.address}: no server answers" in refusal(rig)


def test_an_old_calibration_of_the_tracker(line: SerialLine, refusal: Run, tmp_path: Path) -> None:
    rig = write_rig(tmp_path, "rehearsal", port=f'"{line.url}"', address='"127.0.0.1:9"')
    rig.write_text(rig.read_text("utf-8").replace(str(date.today()), str(date.today() - timedelta(31))), "utf-8")
    (said,) = re.findall(r"tracker\.calibrated_on: got .*", refusal(rig))
    assert f"{date.today() - timedelta(31)}" in said
    assert said.endswith("; run palpate calibrate tracker --rig RIG")


def test_a_panel_that_was_measured_too_long_ago(refusal: Run, tmp_path: Path) -> None:
    rig = write_rig(tmp_path, "rehearsal", port='"nowhere"', address='"127.0.0.1:9"')
    stated, measured, rest = rig.read_text("utf-8").partition("[actuator.measured]")
    table, tracker, others = rest.partition("[tracker]")
    old = table.replace(str(date.today()), str(date.today() - timedelta(31)))
    rig.write_text("".join((stated, measured, old, tracker, others)), "utf-8")
    assert refusal(rig).endswith(f"{shlex.join(CALIBRATE)}\n")
    rig.write_text("".join((stated, tracker, others)), "utf-8")
    assert refusal(rig).endswith(f"{shlex.join(CALIBRATE)}\n")


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"actuator": "9"}, "got 4 outputs and 2 inputs; allowed: at least 9 and 2"),
        ({"rate_hz": "44100"}, "it does not run at 44100 Hz"),
        ({"device": '"hw:9"'}, "got no device with this name"),
        ({"calibration_days": "1"}, "audio.latency: got a calibration from"),
    ],
    ids=["channel", "rate", "device", "old"],
)
def test_a_card_that_is_not_what_the_rig_file_says(
    changed: dict[str, str], said: str, line: SerialLine, refusal: Run, tmp_path: Path
) -> None:
    rig = write_rig(tmp_path, "headless", **({"port": f'"{line.url}"', "device": '"system"'} | changed))
    made = date.today() - timedelta(2 if "calibration_days" in changed else 0)
    files, latency = rig.read_text("utf-8").split("[audio.latency]")
    latency = re.sub(r"calibrated_on = \S+", f"calibrated_on = {made}", latency)
    files = re.sub(r"calibrated_on = \S+", f"calibrated_on = {date.today()}", files)
    text = f"{files}[audio.latency]{latency}"
    # Of a rate that is changed everywhere, the tracker's, which stands first, stays.
    rig.write_text(text.replace("rate_hz = 44100", "rate_hz = 1000", 1), "utf-8")
    with sound.sound_card():
        assert said in refusal(rig)
