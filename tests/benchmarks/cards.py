"""Whether simulated sound cards that begin side by side are found: `python -m tests.benchmarks.cards`.

Each process opens cards one after another, looks for them among the devices, and closes them. All processes do so at
the same time; what one of them does not find, or dies of, is counted. Their number and that of the cards may be given.
"""

from __future__ import annotations

import subprocess
import sys

from palpate.experiment.apparatus.audio.stream import devices
from palpate.experiment.rehearsal.wires.sound_card import DEVICE, SoundCard
from tests.rig import sound

PROCESSES, CARDS = 4, 100


def opened(cards: int) -> int:
    """Return how many of so many cards were found."""
    found = 0
    for _ in range(cards):
        card = SoundCard(rate_hz=sound.RATE_HZ, block=sound.BLOCK, inputs=2, outputs=4)
        found += any(each.name == DEVICE for each in devices())
        card.close()
    return found


def main(processes: int, cards: int) -> None:
    """Print how many were found."""
    told = [sys.executable, "-c", f"from tests.benchmarks.cards import opened; print(opened({cards}))"]
    pipe = subprocess.PIPE
    running = [subprocess.Popen(told, stdout=pipe, stderr=subprocess.DEVNULL, text=True) for _ in range(processes)]
    said = [(each.communicate()[0], each.returncode) for each in running]
    died = sum(code != 0 for _, code in said)
    found = sum(int(text) for text, code in said if code == 0)
    print(f"{found} of {processes * cards} cards found by {processes} processes side by side, of which {died} died")


if __name__ == "__main__":
    given = [int(each) for each in sys.argv[1:]]
    main(*given, *(PROCESSES, CARDS)[len(given) :])
