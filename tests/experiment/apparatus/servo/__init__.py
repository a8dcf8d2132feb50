"""The servo of a virtual block."""
