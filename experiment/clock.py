"""Time as integer nanoseconds since 1970 that never goes back."""

import time
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Protocol


@dataclass(frozen=True)
class Uptime:
    """How long a machine has been switched on, ns, and which time that is; nobody who sets a clock changes it."""

    boot: str
    ns: int


class Clock(Protocol):
    """What the session needs of time."""

    def now_ns(self) -> int:
        """Return nanoseconds since 1970-01-01T00:00Z; they never go back within a process."""

    def sleep_ns(self, duration_ns: int) -> None:
        """Let `duration_ns` pass."""

    def uptime(self) -> Uptime | None:
        """Return the machine's uptime; None where the machine cannot tell, and in simulated time."""

    @property
    def simulated(self) -> bool:
        """Whether its time moves only when somebody lets it pass."""


BOOT = Path("/proc/sys/kernel/random/boot_id")
"""Where Linux names each start of the machine."""

_tells = hasattr(time, "CLOCK_BOOTTIME") and BOOT.exists()


class MonotonicClock:
    """The machine's monotonic clock, anchored once to the wall clock."""

    simulated = False

    def __init__(self) -> None:
        self._anchor_ns = time.time_ns() - time.monotonic_ns()

    def now_ns(self) -> int:
        return self._anchor_ns + time.monotonic_ns()

    def sleep_ns(self, duration_ns: int) -> None:
        time.sleep(max(duration_ns, 0) / 1e9)

    def uptime(self) -> Uptime | None:
        return Uptime(BOOT.read_text("ascii").strip(), time.clock_gettime_ns(time.CLOCK_BOOTTIME)) if _tells else None


def lasted_ms(clock: Clock, since_ns: int) -> float | None:
    """Return how long ago the session time `since_ns` was, ms; None in simulated time, which cannot tell."""
    return None if clock.simulated else (clock.now_ns() - since_ns) / 1e6


def monotonic_ns() -> int:
    """Return the machine's monotonic clock, ns, which all processes of one machine share."""
    return time.monotonic_ns()


def wall_ns() -> int:
    """Return the machine's wall clock, ns since 1970-01-01T00:00Z; unlike a `Clock` it may be set meanwhile."""
    return time.time_ns()


def day(now_ns: int) -> date:
    """Return the day of a clock reading, in the time zone of this machine."""
    return datetime.fromtimestamp(now_ns / 1e9, tz=UTC).astimezone().date()


def utc(now_ns: int) -> str:
    """Return a clock reading as ISO 8601 text, to the second."""
    return datetime.fromtimestamp(now_ns // 1_000_000_000, tz=UTC).isoformat()


def minutes(lasts_s: float) -> str:
    """Return how long something lasts as a person would say it, in whole seconds."""
    whole, rest = divmod(round(lasts_s), 60)
    return " ".join(filter(None, (f"{whole} min" if whole else "", f"{rest} s" if rest or not whole else "")))
