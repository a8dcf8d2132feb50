"""SIMULATED taps: surfaces that ring as those of Wellman and Howe, and a participant who compares them.

What is printed of the surfaces comes in, and answers go out; no printed percentage of right answers is used. Nothing
here says anything of real participants or materials.
"""
