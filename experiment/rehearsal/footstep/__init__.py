"""SIMULATED feet, panels, participants and recordings of the footstep study."""
