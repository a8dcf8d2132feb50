"""What each kind of trial leaves in the journal: its entries, and `LINES`, what makes the line of each in a transcript.

`journal.py` reads the entries, and `transcript.py` collects the lines. A kind never imports another.
"""
