"""The wires of a rehearsal, with both ends on this machine: a serial line and a sound card of software."""
