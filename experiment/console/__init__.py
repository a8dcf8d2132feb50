"""What the experimenter sees."""
