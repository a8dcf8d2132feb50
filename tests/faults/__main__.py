"""Run the fault campaign: `python -m tests.faults [PART...] [--subset]`; without --subset it writes the table.

`python -m tests.faults forged OUT` writes what verify reports of forged datasets, which is no part of the campaign.
"""

from __future__ import annotations

import argparse
import sys
import time

from tests.faults import campaign
from tests.faults.campaign import PARTS, Count, Size
from tests.faults.forged import baseline


def main() -> None:
    if sys.argv[1:2] == ["forged"]:
        sys.exit(baseline.main(sys.argv[2:]))
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"parts to run [default: {' '.join(PARTS)}]")
    parser.add_argument("--subset", action="store_true", help="run the subset that the suite runs")
    asked = parser.parse_args()
    size = Size.SUBSET if asked.subset else Size.WHOLE
    survives = True
    for part in asked.parts or PARTS:
        counts: list[Count] = []
        begun_s = time.monotonic()
        for count in campaign.attacks(part, size):
            counts.append(count)
            print(f"{part}: {count.fault}: {count.survived:,} of {count.tried:,} survived, {count.lost:,} lost")
            print(*(f"  {failure}\n" for failure in count.failures[:20]), sep="", end="", flush=True)
        print(f"{part}: {time.monotonic() - begun_s:.0f} s", flush=True)
        survives &= all(count.survived == count.tried and not count.lost for count in counts)
        if size is Size.WHOLE:
            campaign.write(part, counts)
    sys.exit(not survives)


if __name__ == "__main__":
    main()
