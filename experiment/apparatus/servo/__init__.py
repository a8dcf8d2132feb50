"""The servo of a virtual block: the hand's places come in, and forces go out, thousands of times a second.

`rendering` is pure: samples of the hand in, forces and touches out. `device` is the force device behind a socket. In
real time `process` runs both in a process of its own, so that nothing the session does holds a force up, and `link` is
the session's end of it. Whatever fails, the force is zero within 2 ms: `process` sees to it that a dead session, a
silent hand, a late cycle or a number that is none end the force, and the device drops it where `process` is gone. A
session that stands still for 0.5 s loses its block, and its end takes the block away whatever the session does.

It knows no protocol, no trial and no participant.
"""
