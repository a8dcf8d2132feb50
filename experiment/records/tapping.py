"""Models of what a comparison of two materials leaves in the journal, and the words of its answers."""

from typing import Literal

from palpate.experiment.records.entries import OfAttempt
from palpate.experiment.records.footstep import DeviceUs
from palpate.experiment.records.stimulus import Onset, Stimulus

FIRST, SECOND, TIE = "first", "second", "tie"
WORDS = {FIRST: "the first", SECOND: "the second", TIE: "neither"}
"""What an answer names: the material presented first, the one presented second, or neither."""

Place = Literal["first", "second"]


class PairLaidOut(OfAttempt):
    """Both samples of a pair lay before the participant from the session time `laid_ns` on, ns.

    From then on the participant taps and changes between them at will; of real samples nothing of that is measured. Of
    virtual ones the first is rendered from then on.
    """

    kind: Literal["pair"] = "pair"
    presented: tuple[str, ...]
    laid_ns: int


class Changed(OfAttempt):
    """The participant changed to the other virtual surface of a pair: to that of `material`, at a place of the pair."""

    kind: Literal["changed"] = "changed"
    place: Place
    material: str


class Tapped(OfAttempt):
    """The hand touched a virtual surface, at `device_us` of the tracker's clock and with `speed_mm_s`.

    `fast` says whether it was faster than the protocol wants, so that the lamp was lit. `stimulus` is the vibration
    that was handed over, and `onset` how it met the touch.
    """

    kind: Literal["tapped"] = "tapped"
    place: Place
    material: str
    device_us: DeviceUs
    speed_mm_s: float
    fast: bool
    stimulus: Stimulus
    onset: Onset
