"""The experimenter's desk: the screen that a session or a recording shows, and the keys that come back.

`port.py` is what a session needs of any desk: `terminal.py` on lines of text, `linked.py` with a `console/` in a
process of its own, or a rehearsal's. `voice/` proposes spoken answers, `screen.py` is the participant's. A desk decides
nothing.
"""
