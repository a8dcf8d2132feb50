"""A virtual block and the hand on it: samples of the hand come in, the force on it and every touch go out."""
