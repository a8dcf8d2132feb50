"""Every number of a study of comparisons.

A `Study` whose answers are places in a pair comes in; for each task, the shares of right choices, what presenting a
sample first does, and scales of what was compared go out, each with its interval or the reason why there is none.
Nothing is written or drawn here.
"""
