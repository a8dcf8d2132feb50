"""What commands share: the progress bar."""

from __future__ import annotations

import io
import sys

import pytest

from palpate.experiment.cli import options


def test_the_bar_begins_with_what_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = io.StringIO()
    monkeypatch.setattr(sys, "__stderr__", drawn)
    with options.progress("REHEARSAL", quiet=False) as (begin, advance):
        begin(10, 4)
        advance()
    assert "5/10" in drawn.getvalue()


def test_without_a_terminal_a_line_tells_what_begins_and_each_tenth(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = io.StringIO()
    monkeypatch.setattr(sys, "__stderr__", drawn)
    with options.progress("plan", quiet=False) as (begin, advance):
        assert drawn.getvalue() == "plan ...\n"
        begin(40)
        for _ in range(40):
            advance()
    assert len(drawn.getvalue().splitlines()) == 11
    with options.working("Reading", quiet=True), options.progress("plan", quiet=True) as (begin, advance):
        begin(1)
        advance()
    assert len(drawn.getvalue().splitlines()) == 11
    with options.working("Reading"):
        assert drawn.getvalue().endswith("Reading ...\n")


def test_the_time_of_the_bar_has_a_label(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = io.StringIO()
    monkeypatch.setattr(drawn, "isatty", lambda: True)
    monkeypatch.setattr(sys, "__stderr__", drawn)
    monkeypatch.setenv("TERM", "xterm")
    with options.progress("plan", quiet=False) as (begin, advance):
        begin(1)
        advance()
    assert "elapsed" in drawn.getvalue()
