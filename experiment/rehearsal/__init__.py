"""REHEARSAL: a simulated laboratory at the far ends of the real ports, never a shortcut past them.

A protocol and a simulated rig come in; a dataset of sessions in which nobody took part goes out, and says so in every
file. Feet, panels and participants of a kind of trial stand in a folder of its name, lines and sound cards in `wires/`.
A session never imports this room, and cannot tell a rehearsal from the real thing but by its header.
"""
