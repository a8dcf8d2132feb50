"""What the board's page says of each kind of trial: a module of its name with `WORDS`."""
