"""Signals in closed form: the masker's noise, and the waves that a study declares."""
