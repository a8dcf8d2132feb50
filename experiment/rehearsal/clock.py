"""The clock of a rehearsal."""

from palpate.experiment.clock import Uptime


class ManualClock:
    """Simulated time: it moves only when somebody lets time pass."""

    simulated = True

    def __init__(self, start_ns: int) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        return self._now_ns

    def sleep_ns(self, duration_ns: int) -> None:
        self._now_ns += max(duration_ns, 0)

    def uptime(self) -> Uptime | None:
        return None
