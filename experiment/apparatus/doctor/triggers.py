"""Checks of the rig's triggers: each line is opened, and sent the number that no event has."""

from collections.abc import Iterator
from contextlib import closing

from palpate.experiment.apparatus.doctor.checks import passed, refused
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.apparatus.wires.triggers import TEST, described, open_line
from palpate.experiment.clock import Clock
from palpate.experiment.errors import Finding, RigError


def checks(rig: Rig, *, clock: Clock) -> Iterator[Finding]:
    """Yield for each line where it goes, what it sends, and how long its driver took for the test."""
    for number, settings in enumerate(rig.triggers or (), start=1):
        name = f"trigger line {number}"
        try:
            line = open_line(rig, number)
            begun_ns = clock.now_ns()
            try:
                with closing(line):
                    line.send(TEST, 0.0)
                    took_ms = (clock.now_ns() - begun_ns) / 1e6
            except (Exception, SystemExit) as error:  # a driver may raise anything
                what = f"{described(settings)}: {type(error).__name__}: {error}"
                raise RigError(name, what, "plug it in, or correct its driver") from error
        except RigError as error:
            yield refused(name, error)
        else:
            yield passed(name, f"sent {TEST} as a test in {took_ms:.2f} ms; {described(settings)}")
