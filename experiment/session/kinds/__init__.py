"""The kinds of trial in a session: a room of its name each, whose `trials` has `KIND`; none imports another."""
