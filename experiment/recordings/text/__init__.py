"""Columns of text as numbers, and dates and times of day among them."""
