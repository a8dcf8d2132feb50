"""Datasets on disk: BIDS `beh`, made from journals or from printed counts.

Journals of sessions come in, or a table of counts; events tables, foot traces, participants and descriptions go out,
each file whole, and the same bytes for the same content. This room reads only what is on disk: it knows no device, no
running session and no statistics. `analysis` reads what it writes and never imports it.
"""
