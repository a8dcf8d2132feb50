"""The experimenter's desk: the screen that a session or a recording shows, and the keys that come back.

What is to be shown, or asked, comes in; keys go out. `port.py` says what a session needs of any desk, so that a
rehearsal can sit at one. `terminal.py` is lines of text, over any terminal or a pipe; `linked.py` is a desk whose
`console/` is a process of its own, at the other end of a `link`; `voice/` proposes what was said into a microphone.
`screen.py` is the participant's screen, which is told prompts alone. A desk decides nothing: it opens no device, writes
no entry, and does not know what an answer means.
"""
