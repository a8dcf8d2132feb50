"""Numbers in sentences."""


def number_of(count: int, noun: str) -> str:
    """`1 trial`, `2 trials`."""
    return f"{count} {noun}{'s' * (count != 1)}"
