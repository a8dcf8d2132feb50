"""Who does what and when: participants, their tasks, and the order of their trials.

A protocol and a seed come in; allocations, schedules and a study's roster go out. Every draw is a pure function of what
it is for (`draws`), so that an order comes out the same on any machine, years later. This room knows no device and
runs no session.
"""
