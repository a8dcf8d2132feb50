"""Which presses count."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.desk.console.presses import HELD_S, MOUSE, SEEN_S, Presses

DELAYS_S = (0.225, 0.25, 0.375, 0.4, 0.5, 0.6, 0.66)
"""After which the keys of systems begin to repeat, as they are shipped: macOS, Windows, GNOME, KDE, X11 (xset q)."""


@pytest.mark.parametrize("delay_s", DELAYS_S)
@pytest.mark.parametrize("period_s", [0.011, 0.03, 0.04, 0.09])
def test_a_key_that_is_held_counts_once(delay_s: float, period_s: float) -> None:
    presses = Presses()
    times = [0.0, *(delay_s + period_s * count for count in range(300))]
    assert [presses.continues("enter", at_s) for at_s in times] == [False, *[True] * 300]


def test_it_counts_again_once_it_was_let_go() -> None:
    presses = Presses()
    assert [presses.continues("c", at_s) for at_s in (0.0, 0.5, 0.5 + HELD_S, 0.6 + HELD_S)] == [
        False,
        True,
        False,
        True,
    ]


@pytest.mark.parametrize(("between", "held"), [("c", False), (MOUSE, True)])
def test_another_key_in_between_makes_it_another_press_and_a_click_does_not(between: str, held: bool) -> None:
    """A keyboard repeats the key that was pressed last, and no longer the one before, though that is still down."""
    presses = Presses()
    pressed = [presses.continues(key, at_s) for key, at_s in (("enter", 0.0), (between, 0.1), ("enter", 0.2))]
    assert pressed == [False, False, held]


def test_a_key_does_not_make_it_another_click() -> None:
    presses = Presses()
    assert [presses.continues(key, at_s) for key, at_s in ((MOUSE, 0.0), ("c", 0.1), (MOUSE, 0.2))] == [
        False,
        False,
        True,
    ]


def test_only_what_could_be_seen_is_answered() -> None:
    presses = Presses()
    assert presses.seen(10.0) is None
    presses.drawn(4, 20.0)
    assert [presses.seen(at_s) for at_s in (19.0, 20.0, 20.0 + SEEN_S / 2, 20.0 + SEEN_S)] == [None, None, None, 4]
    presses.drawn(4, 30.0)
    assert presses.seen(30.0) == 4
    presses.drawn(None, 40.0)
    assert presses.seen(50.0) is None
    presses.drawn(4, 60.0)
    assert presses.seen(60.0) is None


@given(st.lists(st.tuples(st.sampled_from("ab"), st.floats(0, 3)), max_size=40))
def test_two_that_count_of_one_key_are_apart_or_have_another_between(gaps: list[tuple[str, float]]) -> None:
    presses, at_s, latest, counted = Presses(), 0.0, "", dict[str, float]()
    for key, gap_s in gaps:
        at_s += gap_s
        if not presses.continues(key, at_s):
            assert key != latest or at_s - counted.get(key, -HELD_S) >= HELD_S
            counted[key] = at_s
        latest = key
