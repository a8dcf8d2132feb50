"""A clock for tests of what waits for a device in real time."""

from __future__ import annotations

from palpate.experiment.rehearsal.clock import ManualClock


class MachineClock(ManualClock):
    """The machine's clock, which the test moves."""

    simulated = False
