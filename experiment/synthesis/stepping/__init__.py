"""Ways to step a virtual block: six to compare with the exact one, their limits of stiffness, and one whole impact."""
