"""Footstep trials, a kind of trial: a foot steps on the panel, and its speed decides what the panel does.

A planned trial and the tracker's samples come in; the stimulus goes to the actuator, and what happened goes out as one
entry of the journal. This room implements the seam of `session/kind.py` and nothing more: it asks no question, keeps no
count of trials, and opens no journal.
"""
