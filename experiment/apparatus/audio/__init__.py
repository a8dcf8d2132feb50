"""The one audio device of a session: masker, stimulus, microphone and loopback on one sample clock.

Waveforms come in with the frame at which they are to leave (`stream`, whose callback is `mixer`); what the inputs heard
goes out. An actuator and a masker are channels of the stream; `calibration` measures the device by its loopback. The
library of the device is imported where it is opened.
"""
