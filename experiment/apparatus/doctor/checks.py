"""Findings of checks, and the checks that need no driver: of rig file and calibrations, disk, clocks and the machine.

A PCM server gets zeros alone, so nothing moves. Disks are checked for room and for how long an entry takes.
"""

import math
import os
import shutil
import tempfile
import textwrap
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path

import numpy as np

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.panel import response_table as response
from palpate.experiment.apparatus.panel import validity
from palpate.experiment.apparatus.panel.conditioning import Conditioner
from palpate.experiment.apparatus.panel.pcm import LOOK_S, PcmActuator
from palpate.experiment.apparatus.rig import ActuatorRig, HeadphonesRig, LatencyRig, Rig, response_table, tracker_of
from palpate.experiment.apparatus.tracker import zeroing
from palpate.experiment.apparatus.tracker.frames import FRAME_BYTES
from palpate.experiment.apparatus.tracker.settings import TrackerRig
from palpate.experiment.clock import Clock, day, wall_ns
from palpate.experiment.errors import ActuatorError, Finding, PalpateError, Remedy, Verdict
from palpate.experiment.findings import wrapped
from palpate.experiment.protocol.models import Step
from palpate.experiment.study.privacy import readable_by_others, to_close

COLORS: Mapping[Verdict, str] = {"passes": "green", "unknown": "not checked", "refuses": "red"}
"""How a verdict is shown, and its word in the document for programs."""


@dataclass(frozen=True)
class Report:
    """What the checks of a rig found, of which one that refuses is red."""

    rig: Path
    checks: list[Finding] = field(default_factory=list)

    @property
    def red(self) -> int:
        """How many checks are red."""
        return sum(check.verdict == "refuses" for check in self.checks)

    @property
    def verdict(self) -> str:
        """The sentence under the checks."""
        are = "is" if self.red == 1 else "are"
        return f"{self.red} of {len(self.checks)} checks {are} red." if self.red else "Nothing is red."

    def as_dict(self) -> dict[str, object]:
        """Return it for programs."""
        return {"rig": str(self.rig), "ready": not self.red, "checks": [*map(record, self.checks)]}


def record(check: Finding) -> dict[str, str]:
    """Return a check for programs."""
    return {
        "name": check.check,
        "verdict": COLORS[check.verdict],
        "measured": check.observation(),
        "allowed": check.allowed,
        "remedy": f"{check.remedy}",
    }


def lines(check: Finding, columns: int) -> Iterator[str]:
    """Yield a check for a terminal of so many columns: what was measured, and the remedy under it."""
    shown = record(check)
    allowed = f" (allowed: {check.allowed})" if check.allowed else ""
    heads = f"{shown['verdict']:11}  {shown['name']:19}  ", " " * 34
    for head, text in zip(heads, (shown["measured"] + allowed, shown["remedy"]), strict=True):
        if text:
            yield from wrapped(text, check.remedy, columns, (head, heads[1]))


def passed(name: str, measured: str, allowed: str = "") -> Finding:
    """Return the finding of a check that found all in order."""
    return Finding(measured, allowed=allowed, verdict="passes", check=name)


def judged(name: str, good: bool, measured: str, *, allowed: str, remedy: Remedy | str) -> Finding:
    """Return a finding that passes if `good`, and else refuses with the remedy."""
    if good:
        return passed(name, measured, allowed)
    return Finding(measured, allowed=allowed, remedy=remedy, check=name)


def unchecked(name: str, reason: str, remedy: Remedy | str = "") -> Finding:
    """Return the finding of what could not be looked at, with the reason."""
    return Finding(reason, remedy=remedy, verdict="unknown", check=name)


def refused(name: str, error: PalpateError) -> Finding:
    """Return the finding that an error carries as that of a check."""
    of_file = error.findings != (error.finding,)
    return replace(error.finding, remedy="correct that file" if of_file else error.finding.remedy, check=name)


def table(rig: Rig, folder: Path) -> Finding | None:
    """Return whether the response table, if any, is usable, has the rig's hash and, on a real rig, is not SIMULATED."""
    shaping = rig.actuator.shaping
    if shaping is None:
        return None
    name = "response table"
    try:
        content = response_table(folder, shaping)
        measured = response.parse(folder / shaping.response, content)
    except PalpateError as error:
        return refused(name, error)
    low_hz, high_hz = measured.frequencies_hz[0], measured.frequencies_hz[-1]
    said = textwrap.shorten(" ".join(response.comments(content)), 160, placeholder=" ...")
    told = f"{shaping.response}: {low_hz:g} to {high_hz:g} Hz, hash matches; its comments: "
    measure = "measure the loaded panel, and add comments (#) that state the date and the load"
    if not said:
        return unchecked(name, f"{told}none, so its date and load are unknown", measure)
    real = rig.rig.simulated or not response.is_simulated(content)
    return judged(name, real, told + said, allowed="" if real else "a measured table", remedy=measure)


def reach(rig: Rig, step: Step) -> Finding:
    """Return whether the calibrated heights reach past a protocol's gate and panel."""
    name = "gate"
    try:
        rigs.check(rig, step)
    except PalpateError as error:
        return refused(name, error)
    heights_mm = [point.mm for point in tracker_of(rig).calibration]
    lowest, highest = rigs.reach_mm(rig, step)
    measured = f"calibrated from {min(heights_mm):g} to {max(heights_mm):g} mm"
    return passed(name, measured, f"from {lowest:g} mm or lower to {highest:g} mm or higher")


OF_LATENCY = "audio calibration"


def ages(rig: Rig, today: date) -> tuple[Finding, ...]:
    """Return how old the calibrations are: of the tracker, of the audio device's latency, of the headphones."""
    tracker, audio = rig.tracker, rig.audio

    def age(
        name: str, check: Callable[[], None], made: LatencyRig | HeadphonesRig | TrackerRig, besides: str = ""
    ) -> Finding:
        if rig.rig.simulated:
            return unchecked(name, "calibrations of a simulated rig do not expire")
        try:
            check()
        except PalpateError as error:
            return refused(name, error)
        days = (today - made.calibrated_on).days if made.calibrated_on is not None else 0
        return passed(name, f"{days} days old{besides}", f"0 to {made.calibration_days} days")

    found = []
    if tracker is not None:
        found.append(age("tracker calibration", lambda: zeroing.check_age(rig, today), tracker))
    if audio is not None:
        found.append(age(OF_LATENCY, lambda: rigs.check_age(audio.latency, today, rig.site), audio.latency))
        level = "; their level was not checked, because the computer cannot measure it"
        found.append(age("headphones", lambda: rigs.check_age(audio.headphones, today), audio.headphones, level))
    return tuple(found)


def panel(rig: Rig, rig_file: Path, today: date) -> Finding:
    """Return whether the panel was measured, and the measurement still counts."""
    name, measured = "panel", rig.actuator.measured
    try:
        found = validity.unmeasured_panel(rig_file, rig, today)
    except PalpateError as error:
        return refused(name, error)
    if found is not None:
        return replace(found, check=name)
    if rig.rig.simulated or measured is None:
        return unchecked(name, "measurements of a simulated rig do not expire")
    age = f"{(today - measured.calibrated_on).days} days old, with {measured.load} on it"
    told = f"full scale {measured.full_scale_m_s2:g} m/s^2, {measured.low_hz:g} to {measured.high_hz:g} Hz"
    return passed(name, f"{age}: {told}", f"0 to {measured.calibration_days} days")


def stops(rig: Rig, limits_m_s2: Mapping[str | None, float], today: date) -> Iterator[Finding]:
    """Yield whether a rig's stops are named and were tried lately, and whether the participant has one."""
    try:
        rigs.check_stops(rig, limits_m_s2, today)
    except PalpateError as error:
        yield refused("stops", error)
    else:
        if (named := rig.stops) is not None:
            yield passed("stops", f"{named.emergency}; {named.limit}; tried on {named.tried_on}")
    name, word = "participant's stop", "no key or pedal: to stop, the participant can only speak up"
    there = [f"the key {rig.screen.stop} at the participant's screen"] if rig.screen is not None else []
    there += [f"a pedal, tried on {rig.pedal.tried_on}"] if rig.pedal is not None else []
    if there:
        yield passed(name, "; ".join(there))
    else:
        yield unchecked(
            name, word, "add a [pedal] table, or a [screen] table, whose key screen.keys.stop stops everything"
        )


SERVED_S, TIMES = 0.5, 3
"""How long a server is sent zeros, s, and how often: a busy machine sends late, and then sees no early close."""

CLOSES_MS = -10.0, 200.0
"""From when to when a server closes, after the last sample or after it was told to stop, ms."""


def server(address: str, settings: ActuatorRig) -> Iterator[Finding]:
    """Yield what the server of a raw PCM actuator does with zeros: takes them in their time, closes, waits, stops."""
    condition = Conditioner(full_scale=settings.full_scale, limit_m_s2=settings.full_scale)
    actuator, other = (PcmActuator(address, condition, rate_hz=settings.rate_hz) for _ in range(2))
    name = "actuator"
    try:
        actuator.reach()
        yield passed(name, f"{address} accepts a connection and closes it at the end")
        name = "actuator samples"
        with ThreadPoolExecutor(1) as beside, closing(actuator):
            yield _closes(name, [actuator.play_silence(SERVED_S) for _ in range(TIMES)], "the last sample")
            name, asked = "actuator turns", beside.submit(_at, SERVED_S / 2, other.reach)
            actuator.play_silence(SERVED_S)
            ended_s = time.monotonic()
            yield _closes(
                name, [(asked.result() - ended_s) * 1e3], "a stimulus during which another connection was opened"
            )
            name, cut = "actuator stop", beside.submit(_at, SERVED_S / 2, actuator.withdraw)
            actuator.play_silence(SERVED_S)
            while not actuator.is_silent() and (time.monotonic() - cut.result()) * 1e3 <= CLOSES_MS[1]:
                time.sleep(LOOK_S)
            ended_ms = (time.monotonic() - cut.result()) * 1e3
            yield _closes(name, [ended_ms], "the connection was cut partway through a stimulus")
    except ActuatorError as error:
        yield refused(name, error)


def _at(after_s: float, call: Callable[[], object]) -> float:
    """Call so much later, and return when that ended, by the machine's monotonic clock, s."""
    time.sleep(after_s)
    call()
    return time.monotonic()


def _closes(name: str, closed_ms: list[float], after: str) -> Finding:
    lowest, highest = CLOSES_MS
    return judged(
        name,
        all(lowest <= one <= highest for one in closed_ms),
        f"closed {' '.join(f'{one:+.0f}' for one in closed_ms)} ms after {after}; zeros were sent 50 ms early",
        allowed=f"{lowest:+g} to {highest:+g} ms",
        remedy="read what a server must do: palpate docs rigs",
    )


BUILT_YEAR = 2026
"""No session is run before palpate was written."""

RESOLUTION_US = 10.0
"""Coarsest step allowed to the monotonic clock, microseconds."""

SET_MS = 10.0
"""By how much wall clock and session clock may part during the checks, ms: slewing parts them by 0.5 ms a second."""

SLEEPS = 200
SLEEP_NS = 1_000_000
LATE_MS = 10.0
"""99 of 100 sleeps end at most this late, ms, as `devices.DELAY_P99_MS` has it."""


@dataclass(frozen=True)
class Mark:
    clock_ns: int
    wall_ns: int


def mark(clock: Clock) -> Mark:
    return Mark(clock.now_ns(), wall_ns())


def resolution(clock: Clock) -> Finding:
    """Return how fine the session's clock is; it must go by itself."""
    steps_ns: list[int] = []
    before_ns = clock.now_ns()
    while len(steps_ns) < 100:
        now_ns = clock.now_ns()
        if now_ns > before_ns:
            steps_ns.append(now_ns - before_ns)
            before_ns = now_ns
    finest_us = min(steps_ns) / 1e3
    return judged(
        "clock resolution",
        finest_us <= RESOLUTION_US,
        f"{finest_us:.3g} us between two readings of the clock",
        allowed=f"at most {RESOLUTION_US:g} us",
        remedy="on Linux, choose the clock source tsc; run sessions on a physical machine, not a virtual one",
    )


def wall(begun: Mark, ended: Mark) -> Finding:
    """Return whether the wall clock is set, and nobody set it between two marks."""
    today = day(ended.wall_ns)
    parted_ms = ((ended.wall_ns - begun.wall_ns) - (ended.clock_ns - begun.clock_ns)) / 1e6
    seconds = (ended.clock_ns - begun.clock_ns) / 1e9
    return judged(
        "wall clock",
        today.year >= BUILT_YEAR and abs(parted_ms) <= SET_MS,
        f"{today}; it drifted from the session's clock by {parted_ms:+.3f} ms in {seconds:.1f} s",
        allowed=f"{BUILT_YEAR} or later, with a drift of at most {SET_MS:g} ms",
        remedy="set the clock, or wait until the time service has set it",
    )


def waking(clock: Clock) -> Finding:
    """Return how late sleeps end, and how loaded the machine is."""
    late_ms = []
    for _ in range(SLEEPS):
        begun_ns = clock.now_ns()
        clock.sleep_ns(SLEEP_NS)
        late_ms.append((clock.now_ns() - begun_ns - SLEEP_NS) / 1e6)
    median, p99, longest = (float(np.quantile(late_ms, q)) for q in (0.5, 0.99, 1.0))
    load = ""
    if hasattr(os, "getloadavg"):
        load = f"; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores, niceness {os.nice(0)}"
    return judged(
        "machine load",
        p99 <= LATE_MS,
        f"sleeps end {median:.2f} ms late (median), {p99:.2f} ms (p99), {longest:.2f} ms (longest){load}",
        allowed=f"p99 at most {LATE_MS:g} ms",
        remedy="close other programs, or raise palpate's priority",
    )


ARMED_S = 60.0
"""How long the foot may be recorded in a trial, s; in the rehearsal it is 0.9 s (10.7 kB a trial at 1 kHz)."""

COPIES = 2
"""The raw frames, and the dataset's own form of them, which compressed takes a fifth."""

JOURNAL_BYTES = 2000
"""Entries of a trial in the journal: 1,450 bytes in the rehearsal."""

ENTRIES = 20
"""How many entries are written."""

ENTRY = b"palpate doctor".ljust(500, b".") + b"\n"

BUDGET_MS = 50.0
"""Time between an answer and the next trial's arming that the experimenter does not notice, ms."""


def session_bytes(*, trials: int, rate_hz: int, readings: int = 1) -> int:
    """Return what a session writes at most, with so many readings in a frame."""
    return math.ceil(trials * (COPIES * ARMED_S * rate_hz * FRAME_BYTES[readings] + JOURNAL_BYTES))


def space(folder: Path, *, trials: int, rate_hz: int, readings: int = 1) -> Finding:
    """Return whether the dataset's disk has room for a session; its folder need not exist yet."""
    name, there = "disk space", _there(folder)
    needed = session_bytes(trials=trials, rate_hz=rate_hz, readings=readings)
    try:
        free = shutil.disk_usage(there).free
    except OSError as error:
        return Finding(
            error.strerror or f"{error}", there, remedy="mount the disk again, or choose another folder", check=name
        )
    return judged(
        name,
        free >= needed,
        f"{free / 1e6:,.0f} MB free at {there}",
        allowed=f"at least {needed / 1e6:,.0f} MB: {trials} trials of {ARMED_S:g} s at {rate_hz} Hz, stored twice",
        remedy="free some space, or put the dataset on another disk",
    )


def writing(folder: Path, clock: Clock) -> Finding:
    """Return whether this user may write in the folder, or the nearest above it, and how long an entry takes."""
    name, there = "disk writing", _there(folder)
    took_ms = []
    try:
        with tempfile.TemporaryFile(prefix=".palpate-doctor-", dir=there, buffering=0) as file:
            for _ in range(ENTRIES):
                begun_ns = clock.now_ns()
                file.write(ENTRY)
                os.fsync(file.fileno())
                took_ms.append((clock.now_ns() - begun_ns) / 1e6)
    except OSError as error:
        return Finding(
            f"is not writable ({error.strerror or error})",
            there,
            remedy="let this user write there, or choose another folder with --dataset",
            check=name,
        )
    median, worst = float(np.median(took_ms)), max(took_ms)
    return judged(
        name,
        worst <= BUDGET_MS,
        f"writing an entry takes {median:.2f} ms (median), {worst:.2f} ms (worst of {ENTRIES}) at {there}",
        allowed=f"at most {BUDGET_MS:g} ms, so participants do not wait",
        remedy="use a local disk, not a network drive or a memory stick; close other programs that write",
    )


def privacy(folder: Path) -> Iterator[Finding]:
    """Yield what others on this machine can read of a dataset's people, seed and roster; nothing where they cannot."""
    if shown := readable_by_others(folder):
        yield Finding(f"other users can read {', '.join(map(str, shown))}", remedy=to_close(folder), check="privacy")


def _there(folder: Path) -> Path:
    resolved = folder.resolve()
    return next((one for one in (resolved, *resolved.parents) if one.is_dir()), resolved)
