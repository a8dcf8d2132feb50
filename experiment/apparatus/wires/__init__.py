"""Small devices on wires of their own: the participant's buttons, and what tells other machines of events.

Presses come in (`buttons`), dated by their board. `settings` has the rig's `[[triggers]]`, `triggers` sends them as a
session goes, on a serial line (`ttl`), by Lab Streaming Layer (`lsl`) or through a driver of one's own.
"""
