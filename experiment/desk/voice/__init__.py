"""Spoken answers: what was said into the microphone while the masker played, and when.

`band` takes the microphone and the played masker, channels of one stream, to 16 kHz, `hearing.py` takes the masker
out, `onset.py` finds utterances, `features.py` describes them, and `matching.py` compares them with this participant's
enrolment, in any language. `ear.py` computes this in a process of its own, `enrolling.py` has the
answers said before. Nothing here decides: the experimenter's key does.
"""
