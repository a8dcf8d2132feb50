"""What is on record of a session: the entries of a journal, the journal itself, and what it says is done.

Values of a session come in and lines on disk go out, each kept before the session moves on. `entries`, `footstep` and
`stimulus` are the models, `events` the columns that tables make of them, `progress` replays a journal, and `transcript`
prints one. This room knows no device and no protocol.
"""
