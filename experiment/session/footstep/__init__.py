"""Trials of the kind footstep: arm, watch the foot, have the stimulus sound at contact, and put the step on record."""
