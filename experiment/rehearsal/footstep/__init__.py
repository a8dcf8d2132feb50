"""experiment/rehearsal/footstep"""
