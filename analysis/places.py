"""Lines of the audit: each at its place in print, about one subject."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from analysis.mistakes import Mistake, explain
from analysis.published import Printed
from analysis.spans import Span
from analysis.verdicts import Line, Verdict, judge, shown


@dataclass(frozen=True)
class Place:
    """Where a printed number stands and what it is about; makes its lines.

    `missing` is the verdict on a number that nothing is known about, `statement` the reason.
    """

    where: str
    task: str
    subject: str
    missing: Verdict
    statement: str = ""

    def number(
        self,
        quantity: str,
        printed: Printed,
        values: Sequence[Span],
        why: Callable[[], Iterable[Mistake]] = tuple,
        *,
        squares: bool = False,
        remark: str = "",
        otherwise: tuple[Verdict, str] = ("differs", ""),
    ) -> Line:
        """A number against the values that it can have.

        Args:
            quantity: what it is.
            printed: the number in print.
            values: see `judge`.
            why: gives the mistakes to try, if any may be tried.
            squares: see `judge`.
            remark: stands after the recomputed number.
            otherwise: the verdict where none fits, and the reason where no mistake gives it.
        """
        if not values:
            return self.text(quantity, printed.text, "-", self.missing, self.statement)
        verdict, fitting = judge(printed, values, squares=squares)
        text, low, high = shown(printed, fitting, squares=squares)
        reason = ""
        if verdict == "differs":
            verdict, reason = otherwise[0], explain(printed, why()) or otherwise[1]
        found = text + remark
        return Line(self.where, self.task, self.subject, quantity, printed.text, found, low, high, verdict, reason)

    def text(self, quantity: str, printed: str, found: str, verdict: Verdict, reason: str = "") -> Line:
        """What is compared as text."""
        return Line(self.where, self.task, self.subject, quantity, printed, found, None, None, verdict, reason)
