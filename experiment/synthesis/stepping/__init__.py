"""Ways to step a virtual block: six to compare with the exact one, how stiff a block each bears, and one whole impact.

The block and its exact stepper are `synthesis/contact/`, which knows nothing of this room.
"""
