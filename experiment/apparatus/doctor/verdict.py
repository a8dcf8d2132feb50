"""What a check found: green, red with the remedy, or not checked with the reason."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from experiment.errors import PalpateError

Verdict = Literal["green", "red", "not checked"]


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Attributes:
        name: what it is.
        verdict: whether a session may rely on it.
        measured: what was found, with units.
        allowed: what may be found; empty where nothing was compared.
        remedy: what to do; empty for green.
    """

    name: str
    verdict: Verdict
    measured: str
    allowed: str = ""
    remedy: str = ""


def judged(name: str, good: bool, measured: str, *, allowed: str, remedy: str) -> Check:
    """Green if `good`, else red with the remedy."""
    return Check(name, "green" if good else "red", measured, allowed, "" if good else remedy)


def unchecked(name: str, reason: str, remedy: str = "") -> Check:
    """What could not be looked at, and why."""
    return Check(name, "not checked", reason, remedy=remedy)


def refused(name: str, error: PalpateError) -> Check:
    """Red, with what an error of palpate says: what it got, what is allowed, and the remedy, which stands last."""
    lines = str(error).splitlines()
    if len(lines) > 1:
        return Check(name, "red", " ".join(line.strip() for line in lines), remedy="correct that file")
    rest, _, remedy = str(error).rpartition("; ")
    measured, _, allowed = rest.partition("; allowed: ")
    return Check(name, "red", measured or remedy, allowed, remedy)
