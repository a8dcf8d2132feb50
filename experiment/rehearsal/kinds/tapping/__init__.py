"""SIMULATED taps: surfaces that ring as those of Wellman and Howe, and a participant who compares them.

Judgments of virtual taps are FITTED to Table 3, those of live taps to nothing. No number is of real participants.
"""
