"""What stands at the far ends of a rehearsal's ports, whatever its kind of trial, and the wires, all on this machine.

SIMULATED foot, panel and force device; a serial line and a sound card of software. Nothing here knows a participant.
"""
