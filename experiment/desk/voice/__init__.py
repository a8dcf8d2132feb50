"""Spoken answers: what was said into the microphone while the masker played, and when; numerics alone.

Samples of the microphone and of what the masker played come in, channels of one stream; an onset in seconds and a
proposed answer with its agreement go out. `band.py` takes both to 16 kHz, `cancelling.py` takes the masker out,
`onset.py` finds utterances, `features.py` says what they sound like, and `matching.py` compares them with what this
participant said at enrolment, in any language. `hearing.py` puts them together.

This room knows of no device, clock, trial or file, and decides nothing: the experimenter's key does.
"""
