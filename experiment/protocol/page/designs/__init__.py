"""What the board's page says of each design: a module of its name with `WORDS`."""
