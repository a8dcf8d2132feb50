"""The simulated serial line and sound card between the simulated world and the real ports."""
