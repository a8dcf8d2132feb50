"""Spoken answers in a session: said twice before, proposed, timed and put on record, and never waited for.

The microphone is scripted, and words are chirps that are made up here.
"""

from __future__ import annotations

import stat
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from syrupy.assertion import SnapshotAssertion

from palpate.experiment import storage
from palpate.experiment.apparatus.audio.microphone import Loudness, Recorded
from palpate.experiment.dataset import build
from palpate.experiment.dataset.kinds.footstep import DATASET
from palpate.experiment.desk.questions import Arm, Question, Reply, Say
from palpate.experiment.desk.voice import ear as ears
from palpate.experiment.desk.voice import enrolling
from palpate.experiment.desk.voice.ear import Ear
from palpate.experiment.desk.voice.enrolling import Enroller
from palpate.experiment.desk.voice.matching import Enrolment
from palpate.experiment.errors import AudioError
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal, transcript
from palpate.experiment.records.entries import Answer, Footer, Phase, Spoken
from palpate.experiment.rehearsal.clock import ManualClock
from tests.experiment.session.bench import Bench, bench, entries, header
from tests.experiment.session.scripted import START_NS, ScriptedConsole

RATE_HZ = 16_000
WORDS = {
    "copy paper": (400, 2600),
    "aluminum foil": (3000, 500),
    "polypropylene": (900, 900),
    "typing paper": (700, 4500),
}
SAID_S = 0.45


def word(name: str) -> NDArray[np.float32]:
    """A chirp between two frequencies that are the word's own, with a harmonic."""
    t = np.arange(round(SAID_S * RATE_HZ)) / RATE_HZ
    low, high = WORDS.get(name, (200, 6000))
    phase = 2 * np.pi * (low * t + (high - low) * t**2 / (2 * SAID_S))
    return np.asarray(0.1 * np.sin(np.pi * t / SAID_S) ** 0.2 * (np.sin(phase) + 0.5 * np.sin(2 * phase)), np.float32)


@dataclass
class ScriptedMicrophone:
    """Implements `Microphone`: quiet, with words at session times, and a masker that does not leak."""

    clock: ManualClock
    said: list[tuple[int, str]] = field(default_factory=list)
    fails: bool = False
    loud: Loudness = field(default_factory=lambda: Loudness(-60.0, False))
    rate_hz: int = RATE_HZ

    def heard(self, *, from_ns: int, until_ns: int) -> Recorded:
        if self.fails:
            raise AudioError("the device stopped")
        n = round((until_ns - from_ns) / 1e9 * RATE_HZ)
        first = round(from_ns / 1e9 * RATE_HZ)
        samples = np.random.default_rng(first).normal(scale=1e-4, size=n).astype(np.float32)
        for at_ns, name in self.said:
            at, made = round((at_ns - from_ns) / 1e9 * RATE_HZ), word(name)
            begin, end = max(at, 0), min(at + made.size, n)
            if begin < end:
                samples[begin:end] += made[begin - at : end - at]
        return Recorded(samples, np.zeros(n, np.float32), from_ns)

    def loudness(self) -> Loudness:
        return self.loud


class Participant(ScriptedConsole):
    """Says what is asked for, and an answer 0.4 s after each question is asked."""

    def __init__(self, clock: ManualClock, keys: str, answers: str, microphone: ScriptedMicrophone) -> None:
        super().__init__(clock, keys, before_ask=self._speak)
        self._microphone = microphone
        self._answers = list(answers)
        self.wrong: list[str] = []
        """What is said instead of the first words that are asked for; nothing is said for "."."""
        self.begun_ns: list[int] = []

    def ask(self, question: Question | Arm) -> Reply:
        if isinstance(question, Say):
            word = self.wrong.pop(0) if self.wrong else question.words
            if word != ".":
                self._microphone.said.append((self._clock.now_ns() + 10**8, word))
        return super().ask(question)

    def _speak(self) -> None:
        self.begun_ns.append(self._clock.now_ns())
        name = {"c": "copy paper", "a": "aluminum foil", "p": "polypropylene", "t": "typing paper", "x": "again please"}
        if (key := self._answers.pop(0)) in name:
            self._microphone.said.append((self._clock.now_ns() + 4 * 10**8, name[key]))


@pytest.fixture
def computing() -> Iterator[Executor]:
    with ThreadPoolExecutor(1) as pool:
        yield pool


def made(keys: str, answers: str, computing: Executor) -> tuple[Bench, ScriptedMicrophone, Participant]:
    one = bench(keys)
    microphone = ScriptedMicrophone(one.clock)
    one.console = participant = Participant(one.clock, keys, answers, microphone)
    one.microphone, one.computing = microphone, computing
    # Steps are 2 s apart.
    participant.confirm_ns = 2 * 10**9
    return one, microphone, participant


@pytest.fixture(autouse=True)
def _visits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is said stays in the test's folder."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


def spoken(folder: Path, task: str = "real") -> list[Spoken]:
    return [entry for entry in entries(folder, task) if isinstance(entry, Spoken)]


def test_what_was_said_is_on_record_and_the_key_decides(
    protocol: Protocol, tmp_path: Path, computing: Executor
) -> None:
    one, _, console = made("cpt", "cat", computing)
    assert one.run(protocol, header("real"), tmp_path / "d") == Footer(reason="complete", answered=3)
    words = [material.spoken[0] for material in protocol.materials]
    assert [(said, take) for said, take, _ in console.said] == [(each, take) for take in (1, 2) for each in words]
    found = spoken(tmp_path / "d")
    assert [(each.trial, each.proposed) for each in found] == [
        (1, "copy paper"),
        (2, "aluminum foil"),
        (3, "typing paper"),
    ]
    answers = [entry for entry in entries(tmp_path / "d", "real") if isinstance(entry, Answer)]
    assert [each.answered for each in answers] == ["copy paper", "polypropylene", "typing paper"]
    path = storage.journal_path(tmp_path / "d", "01", "real")
    rows = build.event_rows(DATASET, path, journal.read(path), "PARTICIPANT")
    assert [row["response_end"] for row in rows] == ["voice", "choice", "voice"]
    for row, said, answer in zip(rows, found, answers, strict=True):
        assert said.onset_s is not None
        # The question comes a moment after contact, and the word 0.4 s after the question.
        asked_s = answer.response_time_s - 1.0
        assert said.onset_s == pytest.approx(asked_s + 0.4, abs=0.015)
        assert (row["choice_time"], row["confirmation_time"]) == (
            pytest.approx(answer.response_time_s, abs=1e-6),
            pytest.approx(answer.response_time_s + 2.0, abs=1e-6),
        )
        assert row["voice_onset"] == pytest.approx(said.onset_s, abs=1e-6)
        expected = said.onset_s if row["response_end"] == "voice" else answer.response_time_s
        assert row["response_time"] == pytest.approx(expected, abs=1e-6)
    told = transcript.text(journal.read(path))
    assert "foil was proposed" in " ".join(told.split())
    assert "proposes answers" in told
    assert not (tmp_path / "d" / "sourcedata" / "sub-01" / "voices").exists()


def test_a_word_that_is_no_answer_and_silence_are_told_apart(
    protocol: Protocol, tmp_path: Path, computing: Executor
) -> None:
    one, _, _ = made("cpt", "x.t", computing)
    one.run(protocol, header("real"), tmp_path / "d")
    first, second, third = spoken(tmp_path / "d")
    assert (first.onset_s is None, first.proposed) == (False, None)
    assert (second.onset_s, second.problem) == (None, "")
    assert third.proposed == "typing paper"


def test_sounds_are_kept_only_where_that_is_allowed_and_for_their_owner_alone(
    protocol: Protocol, tmp_path: Path, computing: Executor
) -> None:
    one, _, _ = made("cpt", "cpt", computing)
    one.keeps_voices = True
    one.run(protocol, header("real"), tmp_path / "d")
    folder = storage.voices_folder(tmp_path / "d", "01")
    names = [f"task-real_trial-{trial:03d}_attempt-1.wav" for trial in (1, 2, 3)]
    assert [each.sound for each in spoken(tmp_path / "d")] == names == sorted(path.name for path in folder.iterdir())
    assert {stat.S_IMODE(path.stat().st_mode) for path in folder.iterdir()} == {0o600}
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


def test_takes_that_cannot_be_used_are_asked_for_again_in_words(
    protocol: Protocol, tmp_path: Path, computing: Executor, approved: SnapshotAssertion
) -> None:
    one, _, console = made("cpt", "cpt", computing)
    # Nothing is said at first; then one answer is said for another.
    console.wrong = [".", "aluminum foil", "aluminum foil"]
    one.run(protocol, header("real"), tmp_path / "d")
    words = [material.spoken[0] for material in protocol.materials]
    assert console.said[1][:2] == (words[0], 1)
    assert console.said[1][2] == approved
    (unlike,) = [line for line in console.shown if line.startswith("The recordings of some answers differ")]
    assert unlike == approved
    # Whoever is named says both takes again; nobody else does.
    again = [word for word in words if f"'{word}'" in unlike]
    assert [said for said, _, _ in console.said[9:]] == [*again, *again]
    assert words[2] not in again
    assert [each.proposed for each in spoken(tmp_path / "d")] == ["copy paper", "polypropylene", "typing paper"]


def test_without_the_microphone_a_session_is_as_ever(
    protocol: Protocol, tmp_path: Path, computing: Executor, approved: SnapshotAssertion
) -> None:
    one, _, console = made("cpt", "cpt", computing)
    console.goes_with_microphone = False
    assert one.run(protocol, header("real"), tmp_path / "d").reason == "complete"
    assert spoken(tmp_path / "d") == []
    (phase,) = [e for e in entries(tmp_path / "d", "real") if isinstance(e, Phase) and e.state == "enrolled"]
    assert phase.detail == approved


def test_a_session_that_goes_on_asks_for_nothing_again(protocol: Protocol, tmp_path: Path, computing: Executor) -> None:
    first, _, console = made("cq", "c.", computing)
    assert first.run(protocol, header("real"), tmp_path / "d").reason == "paused"
    assert len(console.said) == 8
    kept = enrolling.place(tmp_path / "d", "01")
    assert kept is not None
    assert kept.is_relative_to(tmp_path)
    assert not kept.is_relative_to(tmp_path / "d")
    assert stat.S_IMODE(kept.stat().st_mode) == 0o600
    again, _, console = made("pt", "pt", computing)
    assert again.run(protocol, header("real"), tmp_path / "d").reason == "complete"
    assert console.said == []
    assert [each.proposed for each in spoken(tmp_path / "d")] == ["copy paper", "polypropylene", "typing paper"]
    enrolling.forget(kept)
    assert enrolling.load(kept, {}) is None


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04 broken"])
def test_what_was_kept_and_is_broken_is_asked_for_again(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "kept.voice").write_bytes(content)
    assert enrolling.load(tmp_path / "kept.voice", {"a": "a", "b": "b"}) is None
    assert enrolling.load(tmp_path / "missing", {"a": "a", "b": "b"}) is None
    assert enrolling.load(None, {"a": "a", "b": "b"}) is None


class Stuck(ThreadPoolExecutor):
    """Computes nothing until it is let go."""

    def __init__(self) -> None:
        super().__init__(1)
        self.let_go = threading.Event()
        self.submit(self.let_go.wait)


def ear(clock: ManualClock, microphone: ScriptedMicrophone, computing: Executor, written: list[Spoken]) -> Ear:
    made = Ear(
        microphone=microphone,
        computing=computing,
        console=ScriptedConsole(clock, ""),
        clock=clock,
        write=written.append,
        task="real",
        voices=None,
    )
    with ThreadPoolExecutor(1) as pool:
        clock.sleep_ns(10 * 10**9)
        console = Participant(clock, "", "", microphone)
        made.enrolment, _ = Enroller({name: name for name in WORDS}, microphone, pool, console, clock, None).enrol()
    assert isinstance(made.enrolment, Enrolment)
    return made


def test_no_key_waits_for_a_slow_computation() -> None:
    clock, written, slow = ManualClock(START_NS), list[Spoken](), Stuck()
    microphone = ScriptedMicrophone(clock)
    one = ear(clock, microphone, slow, written)
    now_ns = clock.now_ns()
    microphone.said.append((now_ns + 5 * 10**8, "polypropylene"))
    one.listen(1, 1, now_ns)
    clock.sleep_ns(2 * 10**9)
    one.answered(clock.now_ns())
    # The session goes on with the next trial, which is given up.
    one.listen(2, 1, clock.now_ns())
    one.stop()
    assert written == []
    slow.let_go.set()
    one.close()
    slow.shutdown()
    assert [(each.trial, each.proposed) for each in written] == [(1, "polypropylene")]


def test_a_device_that_fails_ends_no_session_and_is_told(computing: Executor) -> None:
    clock, written = ManualClock(START_NS), list[Spoken]()
    microphone = ScriptedMicrophone(clock)
    one = ear(clock, microphone, computing, written)
    microphone.fails = True
    one.listen(1, 1, clock.now_ns())
    one.answered(clock.now_ns())
    one.close()
    assert [(each.problem, each.proposed) for each in written] == [("the device stopped", None)]
    assert one.lamp().words == "the device stopped"
    one.listen(2, 1, clock.now_ns())
    one.answered(clock.now_ns())
    one.close()
    assert len(written) == 1


@pytest.mark.parametrize(
    ("loud", "good", "words"),
    [
        (Loudness(-61.2, False), True, "-61 dB re full scale"),
        (Loudness(-200.0, False), False, "silent: no signal"),
        (Loudness(-10.0, True), False, "clipped: turn down its level"),
    ],
)
def test_the_lamp_tells_how_the_microphone_is(loud: Loudness, good: bool, words: str, computing: Executor) -> None:
    clock = ManualClock(START_NS)
    one = ear(clock, microphone := ScriptedMicrophone(clock), computing, [])
    microphone.loud = loud
    assert (one.lamp().good, one.lamp().words) == (good, words)
    microphone.loud = Loudness(-60.0, False)
    assert one.lamp().good is not loud.clipped
    clock.sleep_ns(int(ears.CLIPPED_S * 1e9) + 1)
    assert one.lamp().good is True
    one.enrolment = None
    assert one.lamp().words.startswith("-60 dB re full ")


def test_bench_has_no_microphone_by_itself(protocol: Protocol, tmp_path: Path) -> None:
    one = bench("cpt")
    one.run(protocol, header("real"), tmp_path)
    path = storage.journal_path(tmp_path, "01", "real")
    rows = build.event_rows(DATASET, path, journal.read(path), "PARTICIPANT")
    assert all("response_end" not in row and "voice_onset" not in row for row in rows)
