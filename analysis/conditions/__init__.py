"""How answers were given, whatever was asked: what the skin touched, and whether the sound was masked."""
