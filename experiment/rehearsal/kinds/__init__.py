"""The kinds of trial in a rehearsal: a room of its name each, whose `participant` has `REHEARSAL`."""
