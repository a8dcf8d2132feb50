"""REHEARSAL: simulated participants and materials that drive the real ports, never a shortcut."""
