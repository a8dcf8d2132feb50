"""Live sessions that end by SIGKILL at a write call of their journal, or before the fsync of one.

`python -m tests.faults.writes KILLS` makes so many, and changes no table.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

from tests.faults import kills
from tests.faults.campaign import Count, Size


def attacks(size: Size) -> Iterator[Count]:
    """Kill 1,000 times."""
    yield from kills.made({kills.AT_CALL: size.of(1, 1000)})


if __name__ == "__main__":
    for count in kills.made({kills.AT_CALL: int(sys.argv[1])}):
        sys.stdout.write(f"{count.fault}: {count.survived} of {count.tried} survived, {count.lost} lost\n")
        sys.stdout.write("".join(f"  {failure}\n" for failure in count.failures))
