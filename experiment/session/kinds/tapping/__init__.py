"""Taps as a kind of trial: two samples are laid out, and the participant says which has more of a quality."""
