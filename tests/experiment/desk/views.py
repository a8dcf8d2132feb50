"""Views of a session, drawn at random, in which every text that may say what is presented holds a mark."""

from __future__ import annotations

from typing import get_args

from hypothesis import strategies as st

from palpate.experiment.desk.link.wire import Asked, Ended, Standing, Told, View
from palpate.experiment.desk.messages import ENTER, Choice, Gauges, Kind, Lamp
from palpate.experiment.protocol.rules import HEARD_KEY, PROBE_KEY

MARK = "aluminum foil"
"""Stands for what is presented."""

KINDS: tuple[str, ...] = get_args(Kind)
STATES = ("preparing", "familiarising", "armed", "answering", "waiting", "paused", "ended")

marked = st.sampled_from([MARK, f"Lay out {MARK}.", f"trial 3: {MARK}"])
numbers = st.floats(0, 1000)
choices = st.lists(
    st.builds(
        Choice,
        key=st.sampled_from(["+", "-", ENTER, PROBE_KEY, HEARD_KEY, "a", MARK]),
        words=marked,
        answer=st.booleans(),
        by=st.sampled_from(["experimenter", "participant", "either"]),
    ),
    max_size=6,
)
questions = st.builds(
    Asked,
    number=st.integers(1, 10_000),
    kind=st.sampled_from(KINDS),
    text=marked,
    choices=choices.map(tuple),
)
gauges = st.builds(
    Gauges,
    left_s=numbers,
    masker_db_a=st.none() | numbers,
    masker_limit_db_a=st.none() | numbers,
    dose=st.none() | numbers,
    stimuli=st.integers(0, 99),
    vibration_s=numbers,
    trace=st.lists(numbers, max_size=3).map(tuple),
    trace_unit=marked,
    moving=st.booleans(),
    last=marked,
    pace=st.sampled_from([None, "slow", "right", "fast"]),
    too_fast=st.sampled_from([None, False, True]),
    delivered=st.sampled_from([None, True, False]),
    lamps=st.lists(st.builds(Lamp, name=marked, good=st.none() | st.booleans(), words=marked), max_size=2).map(tuple),
)
standings = st.builds(
    Standing,
    task=marked,
    trials=st.integers(0, 99),
    answered=st.integers(0, 99),
    remaining=st.integers(0, 99),
    recent=st.lists(st.builds(Told, trial=st.integers(1, 99), words=marked, corrected=st.booleans()), max_size=2).map(
        tuple
    ),
)
views = st.builds(
    View,
    label=st.sampled_from(["", "PRACTICE", "PILOT", MARK]),
    study=marked,
    participant=marked,
    step=marked,
    steps=st.lists(marked, max_size=2).map(tuple),
    state=st.sampled_from(STATES),
    trial=st.none() | st.integers(1, 99),
    attempt=st.integers(1, 9),
    training=st.none() | st.integers(1, 9),
    lay_out=marked,
    heard=marked,
    again=st.sampled_from(["", MARK]),
    answers=choices.map(tuple),
    interval=st.sampled_from([None, 1, 2]),
    asks=st.sampled_from(["", "Did you feel anything?"]),
    instruction=st.sampled_from(["", "Crinkle all four."]),
    standing=standings,
    question=st.none() | questions,
    pause_until_ns=st.none() | st.integers(0, 2**62),
    gauges=st.none() | gauges,
    lines=st.lists(marked, max_size=2).map(tuple),
    ended=st.none() | st.builds(Ended, words=marked, exit_code=st.integers(0, 2)),
)
"""Any view; no text of it but `instruction` may reach the participant."""
