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
