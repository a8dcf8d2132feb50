"""The servo of a virtual block: the hand's places come in, and forces go out, thousands of times a second.

In real time `process` runs `rendering` and `device` in a process of its own, and `link` is the session's end. Whatever
fails, the force is zero within 2 ms: `process` handles a dead session, a silent hand, a late cycle or a bad number, the
device the loss of `process`. A session that stalls for 0.5 s loses its block.
"""
