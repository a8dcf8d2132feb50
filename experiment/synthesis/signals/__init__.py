"""Signals: the masker's noise, the waves that a study declares, and phases beside amplitudes."""
