"""What is on record of a session: the models of its entries, and the journal that holds them.

Entries come in, one by one, and are on disk before the session moves on; they go out again verified, as what is done
and what remains, or as lines that people read. Two things may go wrong with a journal and both are decided here: a torn
last line is dropped and reported, anything else is refused. This room knows no device and no protocol file.
"""
