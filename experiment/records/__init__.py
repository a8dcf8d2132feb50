"""What is on record of a session: the entries of a journal, the journal itself, and what it says is done.

`entries`, `stimulus` and each module of `kinds/` are the models, `progress` replays a journal, `transcript` prints one.
"""
