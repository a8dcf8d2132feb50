"""Faults that are planted in palpate's own source, and which row of the tests has to catch each."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Patch:
    """A fault in one file below the checkout: `new` in the place of `old`, which stands there exactly once.

    `rows` are arguments of pytest, or `campaign:PART`, the subset of a part. `subset` ones are planted in the suite.
    """

    name: str
    file: str
    old: str
    new: str
    rows: tuple[str, ...]
    subset: bool = False

    def plant(self, root: Path) -> None:
        """Change the file. Raises `ValueError` if the text to replace does not stand there exactly once."""
        path = root / self.file
        text = path.read_text("utf-8")
        if text.count(self.old) != 1:
            raise ValueError(
                f"{self.name}: the text to replace stands {text.count(self.old)} times in {self.file}; allowed: once; "
                "write this patch anew for the source as it is"
            )
        path.write_text(text.replace(self.old, self.new), "utf-8")


_T = "tests/experiment/"
_SESSION = f"{_T}session/"
_CORRECTIONS = (
    "    answers, corrections = _by_attempt(recorded, entries.Answer), _by_attempt(recorded, entries.Correction)\n"
)
_ANSWERED = "        answered = None if key == spoken.no_answer_key else answers[key].answer\n"

AWAITED: tuple[str, ...] = ()
"""Faults of parts that palpate does not have yet: each is a row that was not tried until its patch stands below."""

PATCHES = (
    Patch(
        "safe path left out",
        "experiment/storage.py",
        '    return [sys.executable, "-P", *arguments]\n',
        "    return [sys.executable, *arguments]\n",
        (f"{_T}test_working_folder.py",),
    ),
    Patch(
        "answers shown as on disk before they are written",
        "experiment/session/attempt.py",
        _ANSWERED,
        _ANSWERED + "        console.confirmed(trial=planned.trial, answer=answered)\n",
        (f"{_SESSION}test_on_disk.py",),
        subset=True,
    ),
    Patch(
        "a line written without fsync",
        "experiment/records/chain.py",
        "    if wait:\n        os.fsync(file.fileno())\n",
        "    del wait\n",
        (f"{_T}records/test_journal.py::test_an_entry_is_waited_for_unless_it_can_be_rehearsed_again",),
        subset=True,
    ),
    Patch(
        "head not written",
        "experiment/records/chain.py",
        "        self._last = link.sha256\n        self._write_head()\n",
        "        self._last = link.sha256\n",
        (f"{_T}records/test_journal.py",),
    ),
    Patch(
        "chain not verified on read",
        "experiment/records/chain.py",
        "    if (n, prev) != (number, last):\n"
        '        raise error(path, f"{where} does not follow the line before it: '
        'a line was changed or is missing", COPY_FIRST)\n'
        "    # JSON lets a line hold more than what it says, another line among it: blanks, or one key twice.\n"
        "    if not problem and line != _line(number, t_ns, last, entry):\n",
        "    if not problem and line != _line(n, t_ns, prev, entry):\n",
        ("campaign:journals",),
    ),
    Patch(
        "torn line kept",
        "experiment/records/chain.py",
        "            self._cut()\n            self._head = os.open",
        "            self._head = os.open",
        (f"{_T}records/test_journal.py",),
    ),
    Patch(
        "armed although the last stimulus may still play",
        "experiment/session/kinds/footstep/trials.py",
        '        if not silent:\n            raise ActuatorError("actuator", STILL_PLAYS)\n',
        "        del silent\n",
        (f"{_SESSION}kinds/footstep/test_late.py",),
        subset=True,
    ),
    Patch(
        "session time ignored in the runner",
        "experiment/session/exposure.py",
        "        if not self._over and self.clock.now_ns() + ahead_ns > self.ends_ns:\n",
        "        if not self._over and ahead_ns < 0:\n",
        ("campaign:exposure",),
    ),
    Patch(
        "session time ignored in the masker",
        "experiment/session/exposure.py",
        "        if self.clock.now_ns() > self.ends_ns:\n",
        "        if self._over:\n",
        (f"{_SESSION}test_exposure.py::test_the_masker_is_silent_when_the_session_is_over",),
        subset=True,
    ),
    Patch(
        "session time ignored by a virtual block",
        "experiment/session/exposure.py",
        "            self._kind.quiet(why)\n",
        "            pass\n",
        (f"{_SESSION}kinds/tapping/test_virtual.py",),
        subset=True,
    ),
    Patch(
        "session time ignored in the servo",
        "experiment/apparatus/servo/process.py",
        "                told, self._until_ns = json.loads(content)\n",
        "                told, self._until_ns = json.loads(content)[0], 1 << 62\n",
        (f"{_T}apparatus/servo/test_process.py",),
    ),
    Patch(
        "the participant's pedal silences nothing by itself",
        "experiment/session/exposure.py",
        "                self.pause(BY_PARTICIPANT)\n",
        "",
        (f"{_SESSION}test_stalls.py",),
    ),
    Patch(
        "a pedal that fell silent is believed",
        "experiment/apparatus/tracker/pedal.py",
        "        if self._empty >= SILENT_LOOKS:\n",
        "        if self._empty >= 1 << 30:\n",
        ("tests/rig/test_pedal.py",),
    ),
    Patch(
        "a masker that rises before that is on record",
        "experiment/session/masker.py",
        "            self._note(min(level_db_a, self.limit_db_a))\n        self.record()\n",
        "            self._note(min(level_db_a, self.limit_db_a))\n",
        (f"{_SESSION}test_stalls.py",),
    ),
    Patch(
        "heartbeat ignored",
        "experiment/apparatus/servo/process.py",
        "        if self._block is not None and self._until_ns > allowed_ns and now_ns > allowed_ns:\n",
        "        if self._block is not None and self._until_ns > allowed_ns and now_ns < 0:\n",
        (f"{_T}apparatus/servo/test_process.py",),
        subset=True,
    ),
    Patch(
        "dose ignored where a level is set",
        "experiment/apparatus/audio/masker.py",
        "        if lasts_ns <= 0 or self._used_up:\n",
        "        if lasts_ns <= -(10**12):\n",
        (f"{_T}apparatus/audio/test_masker.py",),
    ),
    Patch(
        "dose ignored while the masker plays",
        "experiment/session/masker.py",
        "        self._used_up |= told.dose >= 1 or (told.left_s is not None and told.left_s <= RESERVE_S)\n",
        "",
        (f"{_SESSION}test_masking.py",),
    ),
    Patch(
        "the session's end ignored by the audio callback",
        "experiment/apparatus/audio/stream.py",
        "            for gain in (mixer.whole, mixer.loop):\n",
        "            for gain in (mixer.loop,):\n",
        (f"{_T}apparatus/audio/test_stream.py",),
        subset=True,
    ),
    Patch(
        "the dose's end not given to the audio callback",
        "experiment/apparatus/audio/masker.py",
        "        self._loop.ends_ns = ends_ns\n",
        "        self._loop.ends_ns = SOMETIME\n",
        (f"{_T}apparatus/audio/test_masker.py",),
    ),
    Patch(
        "a device that stood still plays what is past",
        "experiment/apparatus/audio/mixer.py",
        "        elif AT_ONCE < cue.frame < first or self.stood_still:\n",
        "        elif AT_ONCE < cue.frame < first:\n",
        (f"{_T}apparatus/audio/test_mixer.py",),
    ),
    Patch(
        "the masker's lock held while the disk is written",
        "experiment/session/masker.py",
        "        with self._writing:\n",
        "        with self._writing, self._lock:\n",
        (f"{_SESSION}test_masking.py",),
    ),
    Patch(
        "dose halved",
        "experiment/apparatus/audio/masker.py",
        "            self._dose += dose(",
        "            self._dose += 0.5 * dose(",
        ("campaign:exposure",),
    ),
    Patch(
        "level limit of the masker ignored",
        "experiment/apparatus/audio/masker.py",
        "        bounded = min(max(level_db_a, SOFTEST_DB_A), self.limit_db_a)\n",
        "        bounded = max(level_db_a, SOFTEST_DB_A)\n",
        (f"{_T}apparatus/audio/test_masker.py",),
    ),
    Patch(
        "peak limiter that bounds nothing",
        "experiment/apparatus/panel/conditioning.py",
        "    bounded = np.clip(numbers, -peak, peak)\n",
        "    bounded = numbers.copy()\n",
        (f"{_T}apparatus/panel/test_limiter.py",),
    ),
    Patch(
        "the limit of a measured panel without its uncertainty",
        "experiment/apparatus/panel/movement.py",
        "highest * (gain + abs(1 - gain)) + uncertain)",
        "highest * (gain + abs(1 - gain)))",
        (f"{_T}apparatus/panel/test_movement.py",),
    ),
    Patch(
        "a measured panel whose limit nothing keeps",
        "experiment/apparatus/panel/conditioning.py",
        "        if peak.highest_m_s2 > self._limit_m_s2:\n",
        "        if peak.highest_m_s2 > 2 * self._limit_m_s2:\n",
        (f"{_T}apparatus/panel/test_movement.py",),
    ),
    Patch(
        "peak limiter left out before the device",
        "experiment/apparatus/panel/conditioning.py",
        "        bounded, limited = limit(wanted, self._limit)\n",
        "        bounded, limited = limit(wanted, float(np.finfo(np.float32).max))\n",
        (f"{_T}apparatus/panel/test_conditioning.py",),
    ),
    Patch(
        "force limit that bounds nothing",
        "experiment/apparatus/servo/rendering.py",
        "    if size <= most:\n",
        "    if size >= 0:\n",
        (f"{_T}apparatus/servo/test_rendering.py",),
    ),
    Patch(
        "force limit left out before the device",
        "experiment/apparatus/servo/device.py",
        "bounded(force_n, self._limit_n)",
        "bounded(force_n, 1e6)",
        (f"{_T}apparatus/servo/test_device.py",),
    ),
    Patch(
        "armed after the sound",
        "experiment/session/attempt.py",
        "        self.log.write(Armed(trial=planned.trial, attempt=attempt, presented=planned.presented))\n",
        "",
        (f"{_SESSION}test_runner.py",),
    ),
    Patch(
        "an erasure that leaves a file",
        "experiment/storage.py",
        '    source = (*folder.glob("[!.]*"), *_on_their_way(folder))\n',
        '    source = (*folder.glob("[!.]*.jsonl"), *_on_their_way(folder))\n',
        (f"{_T}study/test_erasure.py",),
    ),
    Patch(
        "early key taken",
        "experiment/desk/terminal.py",
        "            early = self._early()\n",
        '            early = ""\n',
        (f"{_T}desk/test_terminal.py",),
    ),
    Patch(
        "lost frame invented",
        "experiment/apparatus/tracker/frames.py",
        "                        device_us.append(us)\n                        readings += reading\n"
        "                        ends.append(ended)\n",
        "                        if skipped:\n                            device_us.append(us - forward_us // 2)\n"
        "                            readings += reading\n                            ends.append(ended)\n"
        "                        device_us.append(us)\n                        readings += reading\n"
        "                        ends.append(ended)\n",
        (f"{_T}apparatus/tracker/test_frames.py",),
    ),
    Patch(
        "lost frame not counted",
        "experiment/apparatus/tracker/frames.py",
        "                            lost += skipped - damaged\n",
        "                            lost += 0\n",
        (f"{_T}apparatus/tracker/test_frames.py",),
    ),
    Patch(
        "foreign journal believed",
        "experiment/dataset/checks.py",
        "def _foreign(path: Path, got: str, allowed: str) -> DatasetError:\n",
        "def _check_header(path: Path, header: Header, study: Dataset) -> None:\n    return\n\n\n"
        "def _foreign(path: Path, got: str, allowed: str) -> DatasetError:\n",
        ("campaign:journals",),
    ),
    Patch(
        "seal not compared",
        "experiment/protocol/approval/__init__.py",
        "    problems = changes(protocol_path, protocol, seal)\n",
        "    problems = changes(protocol_path, protocol, seal)[:0]\n",
        (f"{_T}protocol/test_seal.py",),
    ),
    Patch(
        "unsealed protocol runs",
        "experiment/protocol/approval/__init__.py",
        "    seal = read(protocol_path)\n    problems =",
        "    if not seal_path(protocol_path).exists():\n        return None\n"
        "    seal = read(protocol_path)\n    problems =",
        (f"{_T}protocol/test_seal.py",),
    ),
    Patch(
        "withdrawn participant runs",
        "experiment/session/runner.py",
        "        if said or who in Roster.load(roster_path(dataset)).withdrawn:\n",
        "        if said and who in ():\n",
        (f"{_SESSION}test_runner.py",),
    ),
    Patch(
        "a correction edits in place",
        "experiment/dataset/build.py",
        _CORRECTIONS,
        _CORRECTIONS
        + "    for at in tuple(corrections):\n"
        + "        answers[at] = answers[at].model_copy(update={'answered': corrections.pop(at).answered})\n",
        (f"{_SESSION}test_remarks.py",),
    ),
    Patch(
        "masker continues after pause",
        "experiment/session/runner.py",
        "            self._exposed.pause(detail or reason)\n",
        "",
        (f"{_SESSION}test_masking.py",),
    ),
    Patch(
        "a disk that does not answer ends nothing",
        "experiment/session/exposure.py",
        "        if self.log.waiting_s > GONE_S:\n",
        "        if self.log.waiting_s < 0:\n",
        (f"{_SESSION}test_stalls.py",),
    ),
    Patch(
        "sound that stands still unnoticed",
        "experiment/session/exposure.py",
        "            self.stream.check()\n",
        "            pass\n",
        (f"{_SESSION}test_exposure.py",),
    ),
    Patch(
        "a vibration that sounds on in a pause",
        "experiment/session/kinds/tapping/virtual.py",
        "        self.taps.actuator.withdraw()\n",
        "",
        (f"{_SESSION}kinds/tapping/test_virtual.py",),
    ),
    Patch(
        "a stop lost while the participant's screen is drawn",
        "experiment/desk/screen.py",
        "            self._pressed(heard)\n",
        "            self.window.pressed()\n",
        (f"{_T}desk/test_screen.py",),
    ),
    Patch(
        "a session's end waits for a microphone's process",
        "experiment/desk/voice/ear.py",
        "                if not connection.wait([one.sentinel], ENDS_S):\n",
        "                if not connection.wait([one.sentinel], 20 * ENDS_S):\n",
        (f"{_T}desk/voice/test_computing.py",),
    ),
    Patch(
        "a note on any trial",
        "experiment/session/remarks.py",
        "    if note.trial is None or note.trial in {planned.trial for planned in header.order}:\n",
        "    if note.trial is None or header.order:\n",
        (f"{_SESSION}test_remarks.py",),
    ),
    Patch(
        "any time of the participant's screen",
        "experiment/desk/linked.py",
        "        if told is None or not 0 <= ago_ns <= monotonic_ns() - self._began_ns:\n",
        "        if told is None:\n",
        (f"{_T}desk/test_prompted.py",),
    ),
    Patch(
        "a console that reads nothing is never away",
        "experiment/desk/link/__init__.py",
        "        return bool(self.unsent or self.secret) and time.monotonic() - self.read_s > AWAY_S\n",
        "        return False\n",
        (f"{_T}desk/test_link.py::test_a_console_that_stops_reading_is_away_until_it_reads_again",),
    ),
    Patch(
        "unknown files left out after an erasure",
        "experiment/cli/laboratory.py",
        "    unknown = () if storage.left_of(root, participant) else privacy.unknown_files(root)\n",
        "    unknown: tuple[str, ...] = ()\n",
        (f"{_T}study/test_erasure.py",),
    ),
    Patch(
        "a touch that is read late sounds",
        "experiment/session/kinds/tapping/taps.py",
        "        if late_ns > LATE_NS and not self.lent.clock.simulated:\n",
        "        if late_ns < 0 and not self.lent.clock.simulated:\n",
        (
            f"{_SESSION}kinds/tapping/test_virtual.py::test_a_touch_that_is_read_late_sounds_nothing_and_its_trial_comes_again",
        ),
    ),
    Patch(
        "undelivered stimulus counts as delivered",
        "experiment/session/kinds/footstep/trials.py",
        '                "undelivered": heard is not None and not heard.delivered,\n',
        '                "undelivered": False,\n',
        (f"{_SESSION}test_runner_onset.py",),
        subset=True,
    ),
)
