"""The portable part of palpate, run as it would run on Windows and on macOS."""
