"""A virtual block and the hand on it: samples of the hand come in, the force on it and every touch go out.

`block` has the equations and what a motion is, `oscillator` their solution in time, `exact` the stepper that finds each
touch and release, and `path` follows the hand through several blocks.
"""
