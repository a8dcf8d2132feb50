"""What a participant hears and feels over days of sessions that are killed and paused, on a clock that others set.

The masker and its session are palpate's own; the loop that the masker plays into, the panel and the machine's time are
the tests'. So what was played, and when, is known from outside, and summed by closed form: an hour at L dB(A) is a dose
of 10^((L - 80) / 10) / 8 (2003/10/EC, articles 2 and 3).
"""

from __future__ import annotations

import os
import random
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, cast
from unittest import mock

import numpy as np

from palpate.experiment.apparatus.audio.masker import AudioMasker, MaskerNoise
from palpate.experiment.apparatus.audio.mixer import SOMETIME
from palpate.experiment.apparatus.audio.stream import AudioStream
from palpate.experiment.apparatus.panel.conditioning import Played
from palpate.experiment.apparatus.tracker.clock_map import ClockMap
from palpate.experiment.apparatus.tracker.frames import LinkCounts, Samples
from palpate.experiment.apparatus.tracker.gate import Scrutiny
from palpate.experiment.clock import Uptime
from palpate.experiment.desk.messages import ENTER
from palpate.experiment.desk.questions import (
    Arm,
    Attended,
    Break,
    Event,
    Familiarise,
    GoOn,
    Level,
    Place,
    Proposed,
    Question,
    Reply,
    Rest,
    Say,
    TrialAnswer,
)
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.records.entries import PlannedTrial
from palpate.experiment.session import attempt, runner
from palpate.experiment.session.exposure import Exposed, dose_before
from palpate.experiment.session.kind import Kind
from palpate.experiment.session.kinds.footstep.trials import FootstepDevices
from palpate.experiment.synthesis.waveforms import Waveform
from tests.experiment.session.bench import HEADER, Constant, in_pieces
from tests.experiment.session.scripted import START_NS, ScriptedActuator, rest_samples, step_samples
from tests.experiment.synthesis.stimuli import given
from tests.faults.campaign import Count, Size

SECOND_NS = 10**9
HOUR_NS = 3600 * SECOND_NS
DAY_NS = 24 * HOUR_NS
LIMIT_DB_A, FULL_SCALE_DB_A = 85.0, 100.0
SESSION_MIN = 150
"""So that dose 1 comes after 152 min at the limit: in a second session, or a third."""

SHORT_MIN = 12
"""So that a foot may land as the session ends: 6 min after the familiarisation; dose 1 is far."""

TRIALS = 12
LEAD_NS = 20_000_000
"""Of the panel: a block and what the device holds of them."""

PREPARES_NS = 2_000_000
"""What a stimulus takes to be made."""

SPEED_MM_S = 100.0
FALLS_NS = 300_000_000
"""From the beginning of a step at that speed to its contact, ns."""

STAYS = 5
"""So many fifths of a second the foot stays on the panel."""

OVERRUN_NS = 3 * HOUR_NS
"""Whoever is asked answers before; a session that goes on for so long after its end will not end, and is cut off."""

RUNNERS = 8
"""Of a history: of one task, then of the other."""


class Killed(BaseException):
    """The process ends here: nothing catches it, and nothing is written after it."""


class Machine:
    """Time as it truly is, and what the machine makes of it.

    Somebody looks every second of it, half as often as in real time.
    """

    def __init__(self) -> None:
        self.now_ns = START_NS
        self.set_by_ns = 0
        self.boot, self._booted_ns = 0, START_NS - HOUR_NS
        self.watchers: list[Callable[[], None]] = []
        self.dies_ns: int | None = None
        self.given_up_ns: int | None = None
        self.dead = self.overran = False

    def restart(self) -> None:
        self.boot, self._booted_ns = self.boot + 1, self.now_ns

    @property
    def up_ns(self) -> int:
        return self.now_ns - self._booted_ns

    def go(self, seconds: float) -> None:
        ends_ns = self.now_ns + round(seconds * SECOND_NS)
        while self.now_ns < ends_ns:
            self.now_ns = min(ends_ns, self.now_ns + SECOND_NS)
            self.overran = self.given_up_ns is not None and self.now_ns >= self.given_up_ns
            if self.overran or (self.dies_ns is not None and self.now_ns >= self.dies_ns):
                self.dead = True
                raise Killed
            for look in self.watchers:
                look()


class MachineClock:
    """Implements `Clock` for one process on the machine: anchored to the wall clock when it begins."""

    simulated = False

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._ahead_ns = machine.set_by_ns

    def now_ns(self) -> int:
        return self._machine.now_ns + self._ahead_ns

    def sleep_ns(self, duration_ns: int) -> None:
        self._machine.go(duration_ns / 1e9)

    def uptime(self) -> Uptime:
        return Uptime(f"boot {self._machine.boot}", self._machine.up_ns)


class Heard:
    """Stands for stream and loop of the headphones, and knows from when to when which level was played."""

    def __init__(self, machine: Machine, clock: MachineClock, played: list[tuple[int, int, float]]) -> None:
        self._machine = machine
        self._ahead_ns = clock.now_ns() - machine.now_ns
        self._played = played
        self._gain, self._since_ns = 0.0, machine.now_ns
        self.ends_ns = SOMETIME

    def play_loop(self, samples: object, channels: object) -> Heard:
        return self

    @property
    def wanted(self) -> float:
        return self._gain

    @wanted.setter
    def wanted(self, gain: float) -> None:
        self.ends()
        self._gain = gain

    def ends(self) -> None:
        """Note what was played until now, or until it ended by itself."""
        if self._gain > 0:
            level_db_a = FULL_SCALE_DB_A + 20 * float(np.log10(self._gain))
            until_ns = min(self._machine.now_ns, self.ends_ns - self._ahead_ns)
            self._played.append((self._since_ns, max(until_ns, self._since_ns), level_db_a))
        self._since_ns = self._machine.now_ns


def dose(played: list[tuple[int, int, float]], from_ns: int, until_ns: int) -> float:
    return sum(
        max(min(end, until_ns) - max(begin, from_ns), 0) / HOUR_NS * 10 ** ((level_db_a - 80) / 10) / 8
        for begin, end, level_db_a in played
    )


def beyond_s(played: list[tuple[int, int, float]]) -> float:
    """Return how long the masker played although the dose of the 24 hours before was 1, s."""
    beyond_ns = 0.0
    for begin, end, level_db_a in played:
        spare = 1 - dose(played, end - DAY_NS, begin)
        beyond_ns += max(end - begin - spare * 8 * HOUR_NS / 10 ** ((level_db_a - 80) / 10), 0)
    return beyond_ns / SECOND_NS


class Foot:
    """Implements `Tracker`: the foot rests above the panel for a while after each arming, then steps and stays down.

    Now and then it lands around the session's end. Some reads come late, and what follows comes at once.
    """

    def __init__(self, machine: Machine, clock: MachineClock, dice: random.Random, ends_ns: int) -> None:
        self._machine, self._clock, self._dice = machine, clock, dice
        self._ends_ns = ends_ns
        self._pieces: list[Samples] = []
        self._begins_ns = 0
        self.counts = LinkCounts()
        self.clock_map = ClockMap(machine.now_ns // 1000, clock.now_ns())

    def drain(self) -> None:
        dice, now_ns = self._dice, self._machine.now_ns
        self._pieces = []
        self._begins_ns = now_ns + round(dice.choice([0.5, 5.0, 60.0, 900.0, 2400.0]) * SECOND_NS)
        last_ns = self._ends_ns - FALLS_NS + round(dice.gauss(0.0, 0.05) * SECOND_NS)
        if 0 < last_ns - now_ns < HOUR_NS and dice.random() < 0.7:
            self._begins_ns = last_ns

    def read(self) -> Samples:
        now_ns = self._machine.now_ns
        if now_ns < self._begins_ns:
            self._machine.go(min((self._begins_ns - now_ns) / 1e9, 1.0))
            us = np.array([self._machine.now_ns // 1000])
            return Samples(us, np.array([30.0]), b"0", np.array([1]), self._clock.now_ns())
        if not self._pieces:
            step = step_samples(now_ns // 1000 + 1000, SPEED_MM_S)
            stays = [rest_samples(int(step.device_us[-1]) + 1000 + 200_000 * n, 0.0) for n in range(STAYS)]
            self._pieces = [piece for part in (step, *stays) for piece in in_pieces(part)]
        piece = self._pieces.pop(0)
        late_s = self._dice.choices([0.0, 0.03], [19, 1])[0]
        self._machine.go(max(int(piece.device_us[-1]) * 1000 - now_ns, 0) / 1e9 + late_s)
        return replace(piece, arrived_ns=self._clock.now_ns())

    def reconnect(self, timeout_s: float) -> None:
        raise AssertionError("the foot's tracker never stops")

    def close(self) -> None:
        pass


class Panel(ScriptedActuator):
    """Implements `Actuator` with a lead, as a sound card has one; knows when each stimulus sounded, session time."""

    def __init__(self, clock: MachineClock) -> None:
        super().__init__()
        self._clock = clock
        self.lead_ns = LEAD_NS
        self._onset_ns: int | None = None
        self.sounded_ns: list[int] = []

    def prepare(self, stimulus: Waveform) -> Played:
        self.settle()
        self._clock.sleep_ns(PREPARES_NS)
        return super().prepare(stimulus)

    def aim(self, onset_ns: int) -> bool:
        if self._is_gone or onset_ns < self._clock.now_ns() + self.lead_ns:
            return False
        self._onset_ns = onset_ns
        return super().aim(onset_ns)

    def landed(self, contact_ns: int) -> None:
        super().landed(contact_ns)
        if self._onset_ns is None:
            self._onset_ns = self._clock.now_ns() + self.lead_ns

    def withdraw(self) -> bool:
        self.sounds_anyway = self._is_gone
        self.settle()
        return super().withdraw()

    def settle(self) -> None:
        """What can no longer be taken back sounds; nothing else does."""
        if self._is_gone and self._onset_ns is not None:
            self.sounded_ns.append(self._onset_ns)
        self._onset_ns = None

    @property
    def _is_gone(self) -> bool:
        return self._onset_ns is not None and self._clock.now_ns() >= self._onset_ns - self.lead_ns


class Dawdler:
    """Implements `Console`: an experimenter who is slow, turns the masker up and down, and pauses now and then."""

    def __init__(self, machine: Machine, dice: random.Random) -> None:
        self._machine, self._dice = machine, dice
        self._presses = ["+"] * dice.choice([12, 15, 18])

    def attend(self, session: Attended | None) -> None:
        pass

    def tell(self, event: Event) -> None:
        assert not isinstance(event, Proposed)

    def ask(self, question: Question | Arm) -> Reply:
        match question:
            case Arm():
                return Reply()
            case Familiarise(max_s=max_s):
                self._machine.go(max_s)
            case Level():
                self._machine.go(2.0)
                return Reply(self._presses.pop() if self._presses else ENTER)
            case Place():
                self._machine.go(self._dice.choice([1.0, 30.0, 900.0]))
            case TrialAnswer():
                self._machine.go(self._dice.choice([1.0, 20.0, 600.0, 1800.0]))
                key = self._dice.choices(["c", "+", "-", "r", "q"], [80, 6, 6, 4, 4])[0]
                if key == "q" and self._dice.random() < 0.5:
                    raise KeyboardInterrupt
                return Reply(key)
            case Rest() | Say() | Break() | GoOn():
                raise AssertionError(question.text)
        return Reply(question.choices[0].key if question.choices else "")

    def ignored(self) -> str:
        return ""


@contextmanager
def on(machine: Machine) -> Iterator[None]:
    """Have sessions watched by the machine's time instead of a thread, and nothing written by the dead."""
    append, settle = journal.Journal.append, Exposed.settle

    def appending(self: journal.Journal, entry: Any) -> int:
        if machine.dead:
            raise Killed
        return append(self, entry)

    def begun(self: Exposed, kind: Kind) -> None:
        for looks in (self.look, self.record):
            looks()
            machine.watchers.append(looks)

    def settled(self: Exposed) -> None:
        machine.watchers.clear()
        settle(self)

    with (
        mock.patch.object(journal.Journal, "append", appending),
        mock.patch.object(Exposed, "begin", begun),
        mock.patch.object(Exposed, "settle", settled),
        mock.patch.object(os, "fsync", return_value=None),
    ):
        yield


class History:
    """A participant's sessions, one runner after another."""

    def __init__(self, dataset: Path, seed: int, session_min: int) -> None:
        self._dataset = dataset
        self._session_min = session_min
        self._dice = random.Random(seed)
        self._machine = Machine()
        self._played: list[tuple[int, int, float]] = []
        shown = files.load(shipped("okamoto2012.toml"))
        limits = {"session_min": session_min, "masker_level_db_a": LIMIT_DB_A}
        self._protocol = shown.model_copy(update={"exposure": shown.exposure.model_copy(update=limits)})
        self._spent_ns: dict[str, int] = defaultdict(int)

    @property
    def overran(self) -> bool:
        """Whether a session did not end."""
        return self._machine.overran

    def run(self) -> Iterator[tuple[str, bool, float, str]]:
        """Yield what was attacked, whether it was survived, what was lost, and where.

        Nothing is yielded where nothing could go wrong: before the first session, of a task without an actuator, and
        of dose 1 in sessions that are too short for it.
        """
        before = ""
        tasks = self._dice.sample(["virtual", "real"], 2)
        for number in range(RUNNERS):
            place = 2 * number // RUNNERS
            task = tasks[place]
            machine, clock = self._machine, MachineClock(self._machine)
            with on(machine):
                machine.dead = False
                paths = sorted(self._dataset.glob("sourcedata/sub-01/*_journal.jsonl"))
                believed = dose_before([journal.read(path) for path in paths], clock)
                known = dose(self._played, machine.now_ns - DAY_NS, machine.now_ns)
                where = f"runner {number}: {believed:.5f} believed, {known:.5f} played"
                if number:
                    yield f"dose after {before}", abs(believed - known) <= 0.01 * known + 1e-6, 0.0, where
                ended, late = self._session(task, place + 1, clock, believed)
            if task == "virtual" or machine.overran:
                yield "stimuli after a session's end", late == 0, late, f"runner {number}: {ended}"
            if self._session_min == SESSION_MIN:
                beyond = beyond_s(self._played)
                yield "seconds of masker after dose 1", beyond == 0, beyond, f"runner {number}: {beyond:.3f} s"
            if machine.overran:
                return
            before = self._meanwhile(ended)

    def _session(self, task: str, place: int, clock: MachineClock, believed: float) -> tuple[str, int]:
        machine, dice = self._machine, self._dice
        begun_ns = machine.now_ns
        machine.dies_ns = begun_ns + round(dice.uniform(1500, 9000) * SECOND_NS) if dice.random() < 0.5 else None
        ends_ns = begun_ns + self._session_min * 60 * SECOND_NS - self._spent_ns[task]
        machine.given_up_ns = max(ends_ns, begun_ns) + OVERRUN_NS
        heard, panel = Heard(machine, clock, self._played), Panel(clock)
        noise = MaskerNoise(np.ones(8, np.float32), FULL_SCALE_DB_A, LIMIT_DB_A)
        virtual = task == "virtual"
        silent = {m.id: given([0.0], material=m.id).basis for m in self._protocol.materials}
        devices = attempt.Devices(
            kind=FootstepDevices(
                tracker=Foot(machine, clock, dice, ends_ns),
                tracker_port="scripted",
                noise_mm=0.1,
                scrutiny=Scrutiny(rate_hz=1000, noise_mm=0.1),
                actuator=panel if virtual else None,
                materials={m: Constant(**vars(basis), rendered=[]) for m, basis in silent.items()} if virtual else None,
            ),
            console=Dawdler(machine, dice),
            clock=clock,
            masker=AudioMasker(cast("AudioStream", heard), noise, channels=(1, 2), clock=clock, dose_before=believed),
            reconnect_s=300.0,
        )
        order = tuple(PlannedTrial(trial=n, presented=("copy paper",)) for n in range(1, TRIALS + 1))
        updates = {"task": task, "task_position": place, "order": order, "block_trials": TRIALS}
        asked = HEADER.model_copy(update=updates)
        rig_file = shipped("rigs/rehearsal.toml")
        try:
            footer = runner.run(
                protocol=self._protocol, header=asked, devices=devices, rig_file=rig_file, dataset=self._dataset
            )
            ended = f"a session that was {footer.reason}"
        except Killed:
            ended = "a session that did not end" if machine.overran else "a kill"
        machine.watchers.clear()
        overran, machine.dies_ns, machine.given_up_ns = machine.overran, None, None
        heard.ends()
        panel.settle()
        self._spent_ns[task] += machine.now_ns - begun_ns
        ahead_ns = clock.now_ns() - machine.now_ns
        return ended, overran + sum(sounded_ns - ahead_ns > ends_ns for sounded_ns in panel.sounded_ns)

    def _meanwhile(self, ended: str) -> str:
        """Let time pass until the next session; return what happened last that a dose must survive."""
        machine, dice = self._machine, self._dice
        day = machine.now_ns // DAY_NS
        machine.now_ns += round(dice.choice([60, 600, 2 * 3600, 10 * 3600, 20 * 3600]) * SECOND_NS)
        happened = dice.choice(["nothing", "nothing", "the clock is set", "a restart", "another time zone"])
        if happened == "the clock is set":
            machine.set_by_ns += dice.choice([-1, 1]) * round(dice.uniform(60, 8 * 3600) * SECOND_NS)
        elif happened == "a restart":
            machine.restart()
        elif happened == "another time zone":
            os.environ["TZ"] = dice.choice(["UTC", "Asia/Tokyo", "America/Los_Angeles", "Pacific/Kiritimati"])
            time.tzset()
        else:
            happened = "midnight" if machine.now_ns // DAY_NS > day else ended
        return happened


def attacks(size: Size) -> Iterator[Count]:
    """Run histories; a row for each kind of thing that came before a session, and for what no session may do."""
    tallies: dict[str, list[tuple[bool, float, str]]] = defaultdict(list)
    zone = os.environ.get("TZ")
    with tempfile.TemporaryDirectory() as folder:
        lasting = [SESSION_MIN] * size.of(2, 80) + [SHORT_MIN] * size.of(8, 120)
        for seed, session_min in enumerate(lasting):
            history = History(Path(folder) / str(seed), seed, session_min)
            for what, survived, lost, where in history.run():
                tallies[what].append((survived, lost, f"history {seed}, {where}"))
            if history.overran:
                # Its journals are long, and the others would not end either.
                break
    os.environ.pop("TZ") if zone is None else os.environ.update(TZ=zone)
    time.tzset()
    for what, tried in sorted(tallies.items()):
        failures = tuple(where for survived, _, where in tried if not survived)
        lost = sum(lost for _, lost, _ in tried)
        yield Count(what, len(tried), len(tried) - len(failures), int(np.ceil(lost)), failures)
