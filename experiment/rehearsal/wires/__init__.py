"""The wires of a rehearsal: a serial line and a sound card of software, with both ends on this machine.

Bytes and samples come in at one end and go out at the other, through the operating system and the same libraries as on
a real rig. What they mean is known to whoever holds the ends: this room knows neither feet nor stimuli.
"""
