"""Footstep trials, a kind of trial: a foot steps on the panel, and its speed decides what the panel does."""
