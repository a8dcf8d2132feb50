"""Spoken answers: what was said into the microphone while the masker played, and when.

Samples of the microphone and of what the masker played come in, channels of one stream; an onset in seconds and a
proposed answer with its agreement go out. `band.py` takes both to 16 kHz, `cancelling.py` takes the masker out,
`onset.py` finds utterances, `features.py` says what they sound like, and `matching.py` compares them with what this
participant said at enrolment, in any language. `hearing.py` puts them together.

These are numerics, which know of no device, clock, trial or file. `ear.py` has them computed in a process of their own
while a session goes on, and `enrolling.py` has the participant say the answers before. Nothing here decides: the
experimenter's key does.
"""
