"""The command from outside: its screens, its JSON, and one line for whatever is wrong."""

from __future__ import annotations

import errno
import fcntl
import importlib.abc
import io
import json
import os
import re
import shutil
import sys
import tomllib
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from datetime import date, timedelta
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile
from syrupy.assertion import SnapshotAssertion

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.tracker.serial_port import SerialDevice
from palpate.experiment.dataset import build
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.rehearsal.wires.foot import Foot
from palpate.experiment.rehearsal.wires.serial_line import SerialLine
from palpate.experiment.session import run
from palpate.experiment.settings.characters import hidden
from palpate.experiment.study import privacy, withdrawal
from tests.approved import anywhere
from tests.conftest import Palpate
from tests.rig.laboratory import STOPS, measured


@pytest.fixture
def protocol(tmp_path: Path) -> Path:
    path = tmp_path / "study.toml"
    path.write_bytes(shipped("okamoto2012.toml").read_bytes())
    return path


def lines(text: str) -> list[str]:
    return text.strip().splitlines()


@pytest.mark.parametrize("command", ["analyse", "verify", "build"])
def test_a_link_to_itself_is_told(palpate: Palpate, tmp_path: Path, command: str) -> None:
    (tmp_path / "loop").symlink_to("loop")
    code, _, err = palpate(command, tmp_path / "loop")
    assert (code, "loop" in err) == (2, True)


SHIPPED = ", ".join(sorted(file.stem for file in shipped("okamoto2012.toml").parent.glob("*.toml")))
"""The ids of the protocols that come with palpate."""

NASTY = "a\x1b[2J\u202e\nb"


@pytest.mark.parametrize("command", ["check", "journal", "build", "analyse", "audit", "spectrum", "plan"])
def test_a_file_name_is_never_printed_raw(palpate: Palpate, tmp_path: Path, command: str) -> None:
    code, out, err = palpate(command, tmp_path / f"{NASTY}.toml")
    assert (code, out) == (2, "")
    assert "<U+001B>[2J<U+202E>" in err
    assert not hidden(err, "\n")
    assert not any(line.startswith("b") for line in err.splitlines())


@pytest.mark.parametrize(
    "day", ["2026-11-31", "2026-1-1", "20260101", "tomorrow", "2026-01-01T10:00", "", "\uff12026-01-01"]
)
@pytest.mark.parametrize(
    ("command", "option"),
    [("enrol", "--consent-on"), ("consent", "--consent-on"), ("seal", "--approved-on"), ("seal", "--expires-on")],
)
def test_a_day_that_no_calendar_has_is_refused_in_words(
    palpate: Palpate, protocol: Path, command: str, option: str, day: str
) -> None:
    code, out, err = palpate(command, protocol, option, day)
    assert (code, out) == (2, "")
    assert re.fullmatch(r"palpate: .* '.*; .* YYYY-.*, .* 2026-04-01\n", err)


def test_json_escapes_what_is_not_printed_raw(palpate: Palpate, tmp_path: Path, protocol: Path) -> None:
    moved = protocol.rename(tmp_path / f"{NASTY}.toml")
    code, out, _ = palpate("check", moved, "--json")
    assert code == 0
    assert not hidden(out, "\n")
    assert json.loads(out)["file"] == str(moved)


def test_check_prints_the_boards_page(palpate: Palpate, protocol: Path) -> None:
    code, out, err = palpate("check", protocol)
    assert (code, err) == (0, "")
    assert "Nagoya University" in out
    assert max(map(len, lines(out))) <= 100


def test_check_prints_every_error_at_once_with_line_path_and_what_is_allowed(
    palpate: Palpate, protocol: Path, approved: SnapshotAssertion
) -> None:
    text = protocol.read_text("utf-8")
    text = text.replace('kind = "full-random"', 'kind = "random"').replace("repetitions = 10", "repetitions = 0")
    protocol.write_text(text.replace("participants = 15", 'participants = "many"', 1), "utf-8")
    code, out, err = palpate("check", protocol)
    assert (code, out) == (2, "")
    assert lines(err)[0] == f"palpate: {protocol}: 5 errors"
    assert len(lines(err)) == 6
    kind = text[: text.index('kind = "random"')].count("\n") + 1
    assert f"\n  line {kind}: tasks[0].order.kind: " in err
    assert re.sub(r"line \d+", "line N", anywhere(err, protocol.parent)) == approved
    code, out, _ = palpate("check", protocol, "--json")
    document = json.loads(out)
    assert (code, document["valid"], len(document["errors"])) == (2, False, 5)


def test_check_writes_the_page_as_html_where_it_is_told_and_nowhere_else(
    palpate: Palpate, protocol: Path, approved: SnapshotAssertion
) -> None:
    page = protocol.with_name("board.html")
    code, out, err = palpate("check", protocol, "--html", page)
    assert (code, err, "<h2>12. " in page.read_text("utf-8")) == (0, "", True)
    assert out.replace(str(page), "PAGE") == approved
    before = protocol.read_bytes()
    code, _, err = palpate("check", protocol, "--html", protocol)
    assert (code, "ends in .html" in err, protocol.read_bytes() == before) == (2, True, True)
    assert json.loads(palpate("check", protocol, "--html", page, "--json")[1])["valid"]
    kept = protocol.with_name("own.html")
    kept.write_text("<p>ours", "utf-8")
    assert palpate("check", protocol, "--html", kept)[0] == 2
    assert kept.read_text("utf-8") == "<p>ours"
    protocol.write_text("format = 2", "utf-8")
    page.unlink()
    assert (palpate("check", protocol, "--html", page)[0], page.exists()) == (2, False)


def test_check_json_holds_the_whole_protocol(palpate: Palpate, protocol: Path) -> None:
    code, out, err = palpate("check", protocol, "--json")
    document = json.loads(out)
    assert (code, err, document["valid"]) == (0, "", True)
    assert document["protocol"]["materials"][0]["id"] == "copy paper"
    assert document["advice"] == []
    protocol.write_text(protocol.read_text("utf-8").replace("chance = 0.25", "chance = 0.5"), "utf-8")
    code, out, _ = palpate("check", protocol, "--json")
    assert [(one["path"], one["got"]) for one in json.loads(out)["advice"]] == [("analysis[0].chance", "0.5")]
    assert code == 0


@pytest.mark.parametrize(
    "why",
    [ImportError("No module named 'sounddevice'"), OSError("PortAudio library not found")],
    ids=lambda why: type(why).__name__,
)
def test_without_an_audio_library_serial_ports_are_listed_and_what_to_install(
    palpate: Palpate, monkeypatch: pytest.MonkeyPatch, why: Exception, approved: SnapshotAssertion
) -> None:
    class Missing(importlib.abc.MetaPathFinder):
        def find_spec(self, name: str, path: object, target: object = None) -> None:
            if name == "sounddevice":
                raise why

    monkeypatch.delitem(sys.modules, "sounddevice", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Missing(), *sys.meta_path])
    port = SerialDevice("/dev/ttyACM0", "A tracker", "1234:5678", ("editor (17)",))
    monkeypatch.setattr("palpate.experiment.apparatus.tracker.serial_port.devices", lambda: (port,))
    code, out, err = palpate("devices")
    assert (code, err) == (0, "")
    assert out.replace(str(why), "WHY") == approved
    code, out, err = palpate("devices", "--json")
    document = json.loads(out)
    assert (code, document["serial"][0]["port"], document["audio"]) == (0, "/dev/ttyACM0", None)
    assert "install palpate[lab]" in err


def test_schedule_is_the_same_in_text_and_json(palpate: Palpate, protocol: Path) -> None:
    _, text, _ = palpate("schedule", protocol, "-p", "03", "--seed", 5)
    _, out, _ = palpate("schedule", protocol, "-p", "03", "--seed", 5, "--json")
    tasks = json.loads(out)["tasks"]
    assert {task["task"] for task in tasks} == {"virtual", "real"}
    printed = [line.split(maxsplit=1)[1] for line in lines(text) if not line.startswith("Participant")]
    assert printed == [trial["presented"][0] for task in tasks for trial in task["order"]]


def test_a_protocol_that_comes_with_palpate_is_named_by_its_id_and_a_file_goes_before_it(
    palpate: Palpate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, protocol: Path
) -> None:
    shown = [palpate("schedule", name, "-p", "01")[:2] for name in (protocol, "okamoto2012")]
    assert shown[0] == shown[1]
    monkeypatch.chdir(tmp_path)
    assert palpate("check", "okamoto2012")[0] == 0
    (tmp_path / "okamoto2012").write_text("format = ", "utf-8")
    code, _, err = palpate("check", "okamoto2012")
    assert (code, "okamoto2012: 1 error" in err) == (2, True)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["check", "none.toml"], "none.toml"),
        *(
            (
                list(words),
                "'okamoto': this is not a file or the id of a protocol that comes with palpate; allowed: a "
                f"protocol file, or {SHIPPED}; name one of these",
            )
            for words in [
                ("check", "okamoto"),
                ("rehearse", "okamoto"),
                ("schedule", "okamoto", "-p", "01"),
                ("run", "okamoto", "--practice"),
            ]
        ),
        (
            [
                "seal",
                "okamoto2012",
                "--approval-number",
                "1",
                "--approved-on",
                "2026-01-01",
                "--expires-on",
                "2026-02-02",
            ],
            "okamoto2012: 1 error",
        ),
        (["schedule", shipped("okamoto2012.toml"), "-p", "99"], "no participant '99': this study has '01' to '15'"),
        (["journal", "none.jsonl"], "none.jsonl: cannot read the journal"),
        (["spectrum", "none.wav"], "none.wav"),
        (["analyse", "none"], "none"),
        (["rehearse", "--participants", 16, "--out", "unused"], "--participants: got 16; allowed: 1 to 15, as in"),
        (["rehearse", "--rig", "none.toml", "--out", "unused"], "none.toml"),
        (["rehearse", "--rig", shipped("rigs/headless.toml"), "--out", "unused"], "add --real-time, or give a rig"),
    ],
)
def test_what_is_wrong_is_one_line_and_exit_code_2(
    palpate: Palpate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[object], said: str
) -> None:
    found = [Path(a).resolve() if isinstance(a, Path) else a for a in arguments]
    monkeypatch.chdir(tmp_path)
    code, out, err = palpate(*found)
    assert (code, out) == (2, "")
    assert said in err
    assert "Traceback" not in err
    # A progress bar would say so.
    assert "REHEARSAL" not in err
    assert list(tmp_path.iterdir()) == []


def test_a_fault_in_palpate_itself_is_one_line_too(palpate: Palpate, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("palpate.experiment.records.journal.read", broken)
    code, _, err = palpate("journal", "any.jsonl")
    assert code == 70
    assert "(ZeroDivisionError)" in lines(err)[0]
    report = Path(lines(err)[0].rsplit(" ", 1)[1])
    assert "ZeroDivisionError" in report.read_text()
    report.unlink()


@pytest.mark.parametrize(("error", "said"), [(MemoryError, "not enough memory"), (RecursionError, "too deeply")])
def test_too_much_is_one_line_and_no_fault(
    palpate: Palpate, monkeypatch: pytest.MonkeyPatch, error: type[Exception], said: str
) -> None:
    def beyond(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("palpate.experiment.records.journal.read", beyond)
    code, _, err = palpate("journal", "any.jsonl")
    assert (code, len(lines(err))) == (2, 1)
    assert said in err


@pytest.mark.parametrize("command", ["schedule", "rehearse", "enrol", "power", "record", "validate"])
def test_a_seed_that_no_file_may_hold_is_refused(palpate: Palpate, protocol: Path, command: str) -> None:
    code, _, err = palpate(command, protocol, "--seed", 2**63)
    assert code == 2
    assert "'--seed': " in err
    assert "9223372036854775807" in err


def test_spectrum_draws_only_what_is_asked_for_and_never_over_the_recording(
    palpate: Palpate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
) -> None:
    monkeypatch.chdir(tmp_path)
    wavfile.write(tmp_path / "a.wav", 5000, np.sin(np.arange(500)))
    assert json.loads(palpate("spectrum", "a.wav", "--json")[1])["plot"] is None
    assert "Plot" not in palpate("spectrum", "a.wav")[1]
    assert palpate("spectrum", "a.wav", "--plot", "a.wav")[2] == approved
    assert [path.name for path in tmp_path.iterdir()] == ["a.wav"]


def test_spectrum_lists_plots_and_gives_json(palpate: Palpate, tmp_path: Path) -> None:
    t = np.arange(5000) / 5000
    wavfile.write(tmp_path / "two.wav", 5000, (np.sin(2 * np.pi * 120 * t) + 0.5 * np.sin(2 * np.pi * 700 * t)) / 2)
    code, out, _ = palpate("spectrum", tmp_path / "two.wav", "--plot", tmp_path / "two.svg", "--json")
    assert code == 0
    assert json.loads(out)["peaks_hz"] == pytest.approx([120.0, 700.0], abs=0.5)
    assert (tmp_path / "two.svg").read_text().startswith("<?xml")


@pytest.mark.parametrize("name", ["shock_ring_a0.txt", "shock_ring_a7.txt", "shock_ring_a23.txt"])
def test_spectrum_finds_the_ringing_of_real_recordings(
    palpate: Palpate, real_recordings: Path, tmp_path: Path, name: str
) -> None:
    # Dataset-5 of the High-Rate Structural Health Monitoring Working Group: one damped sinusoid near 802 Hz.
    _, out, _ = palpate("spectrum", real_recordings / name, "--plot", tmp_path / "ring.png", "--json")
    assert json.loads(out)["peaks_hz"][0] == pytest.approx(802, abs=10)


class TestALaboratorysStudy:
    """Seal, enrol and run refuse what the board did not approve."""

    @pytest.fixture
    def rig(self, tmp_path: Path) -> Path:
        path = tmp_path / "rig.toml"
        shutil.copy(shipped("rigs/rehearsal-response.csv"), tmp_path)
        text = shipped("rigs/rehearsal.toml").read_text("utf-8").replace("simulated = true", "simulated = false")
        text = text.replace("[tracker]", f"[tracker]\ncalibrated_on = {date.today()}\ncalibration_days = 30")
        text = text.replace('port = "rehearsal"', f'port = "{(tmp_path / "no-such-port").as_posix()}"')
        text = text.replace('address = "rehearsal"', 'address = "127.0.0.1:9"')
        path.write_text(measured(text, tmp_path) + STOPS.format(day=date.today()), "utf-8")
        return path

    def seal(self, palpate: Palpate, protocol: Path, expires_on: date | None = None) -> tuple[int, str, str]:
        today = date.today()
        expires_on = expires_on or today + timedelta(days=30)
        approved_on = expires_on - timedelta(days=300)
        return palpate(
            "seal", protocol, "--approval-number", "17", "--approved-on", approved_on, "--expires-on", expires_on
        )

    @pytest.fixture(autouse=True)
    def seed(self, protocol: Path, seed_for: Callable[[Path, str], int]) -> None:
        """Seeds under which participant 01 does the real task first."""
        self.real_first: Callable[[], int] = lambda: seed_for(protocol, "real")

    def enrol(self, palpate: Palpate, protocol: Path, participant: str = "01") -> tuple[int, str, str]:
        where = ["--dataset", protocol.with_name("dataset"), "--seed", self.real_first()]
        return palpate("enrol", protocol, "-p", participant, "--consent-on", date.today(), *where)

    def run(self, palpate: Palpate, protocol: Path, rig: Path, task: str = "real") -> tuple[int, str, str]:
        root = protocol.with_name("dataset")
        return palpate("run", protocol, "-p", "01", "--task", task, "--rig", rig, "--dataset", root)

    def test_each_missing_step_is_named(
        self, palpate: Palpate, protocol: Path, rig: Path, monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
    ) -> None:
        monkeypatch.setattr("builtins.input", lambda _: "n")
        root = protocol.with_name("dataset")
        refused = [self.run(palpate, protocol, rig)]
        assert self.seal(palpate, protocol)[0] == 0
        refused.append(self.run(palpate, protocol, rig))
        where = ["--dataset", root]
        assert palpate("enrol", protocol, "-p", "01", *where, "--seed", self.real_first())[0] == 0
        refused.append(self.run(palpate, protocol, rig))
        assert palpate("consent", protocol, "-p", "01", "--consent-on", date.today(), *where)[0] == 0
        refused.append(self.run(palpate, protocol, rig, "virtual"))
        assert [code for code, _, _ in refused] == [2] * 4
        assert [anywhere(err, protocol.parent) for _, _, err in refused] == approved
        code, _, err = self.run(palpate, protocol, rig)
        assert (code, len(lines(err))) == (2, 1)
        assert "/no-such-port: " in err
        assert not list(root.glob("sourcedata/sub-*"))

    @pytest.mark.parametrize(
        ("task", "missing", "told"),
        [("real", "calibrated_on", "calibrated_on"), ("virtual", "recordings", "recordings")],
    )
    def test_nothing_is_asked_of_a_person_before_what_files_can_tell_is_checked(
        self,
        palpate: Palpate,
        protocol: Path,
        rig: Path,
        monkeypatch: pytest.MonkeyPatch,
        seed_for: Callable[[Path, str], int],
        task: str,
        missing: str,
        told: str,
    ) -> None:
        def asks(prompt: str) -> str:
            raise AssertionError(prompt)

        monkeypatch.setattr("builtins.input", asks)
        if missing == "calibrated_on":
            rig.write_text(re.sub(r"(\[tracker\]\n)calibrated_on = .*\n", r"\1", rig.read_text("utf-8")), "utf-8")
        self.seal(palpate, protocol)
        where = ("--dataset", protocol.with_name("dataset"), "--seed", seed_for(protocol, task))
        assert palpate("enrol", protocol, "-p", "01", *where)[0] == 0
        code, _, err = self.run(palpate, protocol, rig, task)
        assert (code, len(lines(err)), told in err) == (2, 1, True), err
        assert not list(protocol.with_name("dataset").glob("sourcedata/sub-*"))

    def test_nothing_is_asked_of_a_person_where_the_rig_has_no_device_for_the_surfaces(
        self, palpate: Palpate, rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def asks(prompt: str) -> str:
            raise AssertionError(prompt)

        monkeypatch.setattr("builtins.input", asks)
        study = tmp_path / "taps.toml"
        shutil.copy(shipped("wellman1995.toml"), study)
        self.seal(palpate, study)
        root = tmp_path / "taps"
        assert palpate("enrol", study, "-p", "01", "--dataset", root)[0] == 0
        code, _, err = palpate("run", study, "-p", "01", "--rig", rig, "--dataset", root)
        assert (code, "[servo]" in err) == (2, True), err

    def test_a_slip_in_a_seal_is_mended(
        self, palpate: Palpate, protocol: Path, monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
    ) -> None:
        assert "replaced" not in self.seal(palpate, protocol)[1]
        days = ("--approved-on", date.today() - timedelta(1), "--expires-on", date.today() + timedelta(1))
        again = ("seal", protocol, "--approval-number", "18 \u05d0", *days)
        code, _, err = palpate(*again)
        assert code == 2
        assert anywhere(err, protocol.parent) == approved
        for typed in ("", "yes\n", "replace\n"):
            monkeypatch.setattr("sys.stdin", io.StringIO(typed))
            code, out, err = palpate(*again, "--replace")
            assert (code, bool(err)) == ((0, False) if typed == "replace\n" else (2, True))
            assert anywhere(out + err, protocol.parent) == approved
        assert palpate(*again, "--replace", "--yes")[0] == 0
        assert anywhere(palpate(*again, "--yes")[2], protocol.parent) == approved
        sealed = "SEALED: this version is approved. Compare the seal with the board's letter."
        _, told = palpate("check", protocol)[1].split(f"\n{sealed}\n")
        assert "  Approval number\n                   | 18 \u05d0\n" in told
        known = json.loads(palpate("check", protocol, "--json")[1])
        assert (known["seal"], known["approval"]["approved_on"]) == (sealed, str(days[1]))

    def test_a_protocol_changed_after_its_approval_is_refused(
        self, palpate: Palpate, protocol: Path, rig: Path, approved: SnapshotAssertion
    ) -> None:
        self.seal(palpate, protocol)
        protocol.write_text(protocol.read_text("utf-8").replace("repetitions = 10", "repetitions = 12"), "utf-8")
        code, _, err = self.run(palpate, protocol, rig)
        assert code == 2
        assert anywhere(err, protocol.parent) == approved

    def test_an_expired_approval_is_refused(
        self, palpate: Palpate, protocol: Path, rig: Path, approved: SnapshotAssertion
    ) -> None:
        self.seal(palpate, protocol, date.today() - timedelta(days=1))
        assert anywhere(self.run(palpate, protocol, rig)[2], protocol.parent) == approved

    def test_a_simulated_rig_is_refused(self, palpate: Palpate, protocol: Path) -> None:
        self.seal(palpate, protocol)
        self.enrol(palpate, protocol)
        _, _, err = self.run(palpate, protocol, shipped("rigs/rehearsal.toml"))
        assert "rig is simulated" in err

    def test_nobody_withdraws_while_their_session_runs(
        self, palpate: Palpate, protocol: Path, approved: SnapshotAssertion
    ) -> None:
        root = protocol.with_name("dataset")
        self.seal(palpate, protocol)
        self.enrol(palpate, protocol)
        asked = ("withdraw", protocol, "-p", "01", "--dataset", root, "--reason", "asked to stop")
        before = (root / "sourcedata" / "roster.jsonl").read_bytes()
        with journal.locked(root / "sourcedata" / "sub-01", "01"):
            code, _, err = palpate(*asked)
            # And nothing is asked before.
            assert palpate(*asked, "--erase") == (code, "", err)
        assert code == 2
        assert anywhere(err, protocol.parent) == approved
        assert (root / "sourcedata" / "roster.jsonl").read_bytes() == before
        assert palpate(*asked)[0] == 0

    def test_nobody_withdraws_who_is_not_enrolled(self, palpate: Palpate, protocol: Path) -> None:
        root = protocol.with_name("dataset")
        self.seal(palpate, protocol)
        self.enrol(palpate, protocol)
        code, _, err = palpate("withdraw", protocol, "-p", "02", "--dataset", root, "--reason", "asked to stop")
        assert code == 2
        assert "'02' is not enrolled" in err
        assert not (root / "sourcedata" / "sub-02").exists()

    def test_a_withdrawn_participant_is_not_run(
        self, palpate: Palpate, protocol: Path, rig: Path, approved: SnapshotAssertion
    ) -> None:
        root = protocol.with_name("dataset")
        self.seal(palpate, protocol)
        self.enrol(palpate, protocol)
        assert palpate("withdraw", protocol, "-p", "01", "--dataset", root, "--reason", "asked to stop")[0] == 0
        assert anywhere(self.run(palpate, protocol, rig)[2], protocol.parent) == approved

    def test_nobody_is_enrolled_under_a_version_that_was_not_approved(
        self, palpate: Palpate, protocol: Path, approved: SnapshotAssertion
    ) -> None:
        self.seal(palpate, protocol)
        text = protocol.read_text("utf-8")
        protocol.write_text(text.replace("vibration_peak_m_s2 = 30", "vibration_peak_m_s2 = 31"), "utf-8")
        assert protocol.read_text("utf-8") != text
        root = protocol.with_name("dataset")
        code, _, err = palpate("enrol", protocol, "-p", "01", "--dataset", root, "--consent-on", "2026-05-04")
        assert code == 2
        assert anywhere(err, protocol.parent) == approved
        assert not root.exists()

    def test_a_name_stands_in_no_dataset_and_goes_with_the_withdrawal(
        self,
        palpate: Palpate,
        protocol: Path,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        approved: SnapshotAssertion,
    ) -> None:
        monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "mine"))
        root = protocol.with_name("dataset")
        self.seal(palpate, protocol)
        self.enrol(palpate, protocol)
        person = ("person", protocol, "-p", "01", "--dataset")

        def type_lines(*lines: str) -> None:
            monkeypatch.setattr("sys.stdin", io.StringIO("".join(f"{line}\n" for line in lines)))

        for name, contact in (("Zoë Quux", ""), ("", "room 7")):
            type_lines(name, contact)
            assert palpate(*person, root)[0] == 0
        assert "Zoë Quux, room 7" in palpate(*person, root, "--show")[1]
        type_lines("", "a\x1bb")
        assert palpate(*person, root)[0] == 2
        assert palpate(*person, root, "--forget", "--show")[0] == 2
        assert palpate(*person, root, "--name", "Zoë Quux")[0] == 2
        root = root.rename(root.with_name("moved"))
        code, out, _ = palpate("withdraw", protocol, "-p", "01", "--dataset", root, "--reason", "asked to stop")
        assert code == 0
        assert anywhere(out, tmp_path) == approved
        assert "nothing is stored" in palpate(*person, root, "--show")[1]
        holding = [path for path in tmp_path.rglob("*") if path.is_file() and b"Quux" in path.read_bytes()]
        assert holding == []
        type_lines()
        assert palpate(*person, root)[0] == 2

    @pytest.mark.parametrize("meanwhile", ["_wait_for_break", "open_laboratory"])
    def test_who_withdraws_before_the_session_begins_is_not_run(
        self, palpate: Palpate, protocol: Path, rig: Path, monkeypatch: pytest.MonkeyPatch, meanwhile: str
    ) -> None:
        """In the break, or while the devices are opened."""
        root = protocol.with_name("dataset")
        self.seal(palpate, protocol)
        self.enrol(palpate, protocol)

        def withdraws(*_: object, **__: object) -> AbstractContextManager[None]:
            withdrawal.withdraw(protocol, "01", "asked to stop", root=root, rebuild=build.build)
            return nullcontext()

        monkeypatch.setattr(run, meanwhile, withdraws)
        code, _, err = self.run(palpate, protocol, rig)
        assert (code, len(lines(err))) == (2, 1)
        assert "01 withdrew" in err
        assert not list(root.glob("sourcedata/sub-01/*.jsonl"))

    def test_a_register_in_a_home_that_nobody_knows_is_refused_before_anybody_is_run(
        self, palpate: Palpate, protocol: Path, rig: Path, monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
    ) -> None:
        self.seal(palpate, protocol)
        self.enrol(palpate, protocol)
        rig.write_text(rig.read_text("utf-8") + '\n[anchors]\nfile = "~/register"\n', "utf-8")
        # Neither the environment nor the system's users tell it.
        monkeypatch.setattr(os.path, "expanduser", lambda path: path)
        code, _, err = self.run(palpate, protocol, rig)
        assert code == 2
        assert anywhere(err, protocol.parent) == approved

    @pytest.mark.parametrize(("days", "allowed"), [(1, "up to"), (-400, "from")])
    def test_a_day_on_which_nobody_can_have_consented_is_refused(
        self, palpate: Palpate, protocol: Path, days: int, allowed: str
    ) -> None:
        root = protocol.with_name("dataset")
        self.seal(palpate, protocol)
        day = date.today() + timedelta(days)
        code, _, err = palpate("enrol", protocol, "-p", "01", "--consent-on", day, "--dataset", root)
        assert code == 2
        assert f" {day}; allowed: {allowed} " in err
        assert not root.exists()
        self.enrol(palpate, protocol)
        where = ("-p", "01", "--dataset", root)
        assert f"allowed: {allowed} " in palpate("consent", protocol, "--consent-on", day, *where)[2]
        before = date.today() - timedelta(1)
        asked = ("consent", protocol, "--consent-on", before, *where, "--correct")
        assert "--correct and --reason" in palpate(*asked)[2]
        assert palpate(*asked, "--reason", "the letter")[0] == 0
        entries = [
            json.loads(line)["entry"] for line in (root / "sourcedata" / "roster.jsonl").read_text().splitlines()
        ]
        assert [entry["consent_on"] for entry in entries] == [str(date.today()), str(before)]

    def test_who_enrols_under_a_protocol_without_a_seal_is_told(
        self, palpate: Palpate, protocol: Path, approved: SnapshotAssertion
    ) -> None:
        code, _, sealed = self.enrol(palpate, protocol)
        assert code == 0
        new = protocol.with_name("new.toml")
        assert palpate("new", new, "--id", "fresh", "--yes")[0] == 0
        code, _, unfilled = palpate("enrol", new, "-p", "01", "--dataset", protocol.with_name("fresh"))
        assert (code, protocol.with_name("fresh").exists()) == (2, False)
        assert [anywhere(err, protocol.parent) for err in (sealed, unfilled)] == approved

    def test_who_enrols_under_a_sealed_protocol_is_told_nothing(self, palpate: Palpate, protocol: Path) -> None:
        self.seal(palpate, protocol)
        assert self.enrol(palpate, protocol)[2] == ""

    def test_a_refused_enrolment_begins_nothing(self, palpate: Palpate, protocol: Path) -> None:
        assert "allowed: 01" in self.enrol(palpate, protocol, "02")[2]
        assert not protocol.with_name("dataset").exists()

    @pytest.mark.parametrize("left", ["nothing", "folder", "seed"])
    def test_a_study_whose_beginning_was_killed_begins_again(self, palpate: Palpate, protocol: Path, left: str) -> None:
        root = protocol.with_name("dataset")
        self.enrol(palpate, protocol)
        (root / "sourcedata" / "protocol.toml").unlink()
        for path in root.glob("sourcedata/*roster*"):
            path.unlink()
        if left != "seed":
            (root / "sourcedata" / "seed.json").unlink()
        if left == "nothing":
            shutil.rmtree(root)
        assert self.enrol(palpate, protocol)[0] == 0

    def test_a_study_never_writes_into_another_dataset(self, palpate: Palpate, protocol: Path) -> None:
        root = protocol.with_name("dataset")
        root.mkdir()
        (root / "data.tsv").write_text("precious")
        _, _, err = palpate("enrol", protocol, "-p", "01", "--dataset", root)
        assert "with --dataset" in err
        assert [path.name for path in root.iterdir()] == ["data.tsv"]

    def test_a_silent_port_pauses_the_session_with_the_remedy(
        self, palpate: Palpate, protocol: Path, rig: Path, monkeypatch: pytest.MonkeyPatch, approved: SnapshotAssertion
    ) -> None:
        root = protocol.with_name("dataset")
        line = SerialLine()
        foot = Foot(line, tracker_of(rigs.load(rig)), real_time=True)
        missing = (rig.parent / "no-such-port").as_posix()
        rig.write_text(rig.read_text("utf-8").replace(missing, line.url), "utf-8")
        protocol.write_text(protocol.read_text("utf-8").replace("min_s = 180", "min_s = 0"), "utf-8")
        self.seal(palpate, protocol)
        self.enrol(palpate, protocol)

        def falls_silent(prompt: str) -> str:
            if "Lay out" in prompt:
                foot.close()
            return "y" * ("[y]" in prompt)

        monkeypatch.setattr("builtins.input", falls_silent)
        monkeypatch.setattr("palpate.experiment.session.run.RealEnds.reconnect_s", 0.2)
        code, out, err = self.run(palpate, protocol, rig)
        assert code == 0, err
        assert "Trial 1 of 40. Armed" in out
        shown = re.sub(r"/dev/\S+?(?=[:;,]? )", "PORT", anywhere(out, protocol.parent))
        assert shown.partition("Armed: ")[2].partition(": not back within 0.2 s")[0] == approved
        file = root / "sourcedata" / "sub-01" / "sub-01_task-real_journal.jsonl"
        code, out, _ = palpate("journal", file)
        assert code == 0
        assert "paused (tracker at" in out
        code, out, err = self.run(palpate, protocol, rig)
        line.unplug()
        assert (code, "Trial" in out, "for 200 ms" in err) == (2, False, True)


def test_a_plan_names_its_rig_and_what_is_off(palpate: Palpate, monkeypatch: pytest.MonkeyPatch) -> None:
    # What is left out is measured, and not asked for here.
    monkeypatch.setattr("palpate.experiment.session.kinds.footstep.scene_cost.REPEATS", 1)
    code, out, err = palpate("plan", "okamoto2012", "--task", "real")
    named = tomllib.loads(shipped("rigs/rehearsal.toml").read_text("utf-8"))["rig"]["name"]
    assert (code, f"\nRig: {named} (SIMULATED)\n" in out) == (0, True), err
    code, out, err = palpate("plan", "wellman1995")
    assert (code, "\nRig: tapping (SIMULATED)\n" in out) == (0, True), err
    code, out, _ = palpate("plan", "wellman1995", "--json")
    live, virtual = json.loads(out)["tasks"]
    assert (live["force"], live["needs"]) == (None, ["screen and keys", "journal"])
    assert [row["cause"] for row in virtual["force"]][-2:] == ["trembling", "limit"]
    assert {0.03 < virtual["force"][-2]["rest"] < 0.06, 0.4 < virtual["force"][-2]["175 mm/s"] < 0.7} == {True}


def test_errors_of_a_rig_file_stand_in_lines_of_their_own(palpate: Palpate, tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    text = shipped("rigs/rehearsal.toml").read_text("utf-8")
    rig.write_text(text.replace("rate_hz = ", "rate_hz = -"), "utf-8")
    code, _, err = palpate("plan", "okamoto2012", "--rig", rig)
    assert (code, "<U+000A>" in err, len(lines(err)) > 1) == (2, False, True)


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS, errno.ENOSPC])
def test_what_a_disk_refuses_at_the_start_is_told_with_the_file_and_a_remedy(
    palpate: Palpate, protocol: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def refuses(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", refuses)
    monkeypatch.setattr(fcntl, "lockf", refuses)
    code, out, err = palpate("enrol", protocol, "-p", "01", "--dataset", tmp_path / "data")
    assert (code, out) == (2, "")
    assert str(tmp_path / "data" / "sourcedata") in err
    assert os.strerror(number) in err
    assert storage.REMEDIES[number] in err


def test_who_enrols_is_told_what_others_can_read(
    palpate: Palpate, protocol: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Path] = []

    def warning(root: Path) -> str:
        asked.append(root)
        return "SHOWN"

    monkeypatch.setattr(privacy, "readers_warning", warning)
    code, _, err = palpate("enrol", protocol, "-p", "01", "--dataset", tmp_path / "data")
    assert (code, asked, "SHOWN" in err) == (0, [tmp_path / "data"], True)
