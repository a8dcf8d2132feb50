"""Presented stimuli, a kind of trial: somebody or the clock sets them off, and no tracker follows anybody."""
