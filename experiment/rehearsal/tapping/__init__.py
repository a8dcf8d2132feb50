"""SIMULATED taps: surfaces that ring as those of Wellman and Howe, and a participant who compares them.

What is printed of the surfaces comes in, and answers go out. The judgement of virtual taps is FITTED to the printed
percentages of Table 3, that of live taps to nothing. Nothing here says anything of real participants or materials.
"""
