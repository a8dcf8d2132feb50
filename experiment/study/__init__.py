"""Who does what and when: participants, their tasks, and the order of their trials.

Every draw is a pure function of its purpose (`draws`): the same on every machine, years later.
"""
