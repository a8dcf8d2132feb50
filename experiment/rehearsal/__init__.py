"""REHEARSAL: simulated participants and materials that drive the real ports, never a shortcut.

`study` rehearses a whole study and `session` its participants, with the real session in between; `footstep` simulates
foot, panel, participant and recordings, and `wires` the cables between them and the ports.
"""
