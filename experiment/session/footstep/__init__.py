"""experiment/session/footstep"""
