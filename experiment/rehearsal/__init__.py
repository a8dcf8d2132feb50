"""REHEARSAL: a simulated laboratory at the far ends of the real ports, never a shortcut past them.

Every file says so. A session cannot tell a rehearsal from the real thing but by its header. Lines and sound cards are
in `wires/`, feet, panels and participants in a folder for each kind of trial.
"""
