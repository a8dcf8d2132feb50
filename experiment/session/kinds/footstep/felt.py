"""How a measured panel changes a stimulus: third octaves, envelope, and how probably a person notices, by a model.

All follow from the panel's complex response, with its phase.
"""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from operator import attrgetter
from pathlib import Path

from palpate.experiment.apparatus.panel.conditioning import INVERSE, Played
from palpate.experiment.apparatus.panel.movement import DRIFT_DB, open_movement
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.synthesis.budget import Budget
from palpate.experiment.synthesis.felt import LEAST_SHARE, QUIETEST_DB, WINDOW_S, Felt
from palpate.experiment.synthesis.noticing import SOLE


def gain_sentence(one: Budget) -> str:
    """Return how far the inverse of a panel goes, by the budget of a stimulus, and what is shown of it."""
    most = import_module(INVERSE).MOST_GAIN
    return (
        f"The inverse has a gain of up to {one.gain:.3g} at {one.gain_hz:.0f} Hz, relative to the mean of the panel's "
        f"usable band. The gain is limited to {most:g}; above that, the vibration is weaker than requested. "
        "'Before onset, by the inverse': how much the panel moves before a vibration begins."
    )


FELT_ROWS: tuple[tuple[str, Callable[[Felt], float], Callable[[float], str]], ...] = (
    ("third octaves, dB", attrgetter("third_octave_db"), "{:.1f}".format),
    ("third octaves at most, dB", lambda felt: felt.third_octave_between_db[1], "{:.1f}".format),
    ("envelope, dB", attrgetter("envelope_db"), "{:.1f}".format),
    ("envelope at most, dB", lambda felt: felt.envelope_between_db[1], "{:.1f}".format),
    ("noticed at least, %", attrgetter("noticed_at_least"), lambda share: f"{share * 100:.0f}"),
    ("noticed at most, %", attrgetter("noticed_at_most"), lambda share: f"{share * 100:.0f}"),
)
"""Each line of a measured panel, the value of `Felt`, and how it is shown."""

FELT = (
    "Third octaves and envelope compare the requested vibration with the panel's movement, computed from its "
    f"measured response with phase: the worst third octave from 10 to 500 Hz with at least {LEAST_SHARE:.1%} of the "
    f"energy, and the worst {WINDOW_S * 1e3:g} ms within {QUIETEST_DB:g} dB of the loudest. 'At most' assumes that "
    f"the panel's response has drifted by {DRIFT_DB:g} dB, or that its coil is soft. 'Noticed': probability that a "
    f"person notices the difference, excluding guesses, by an untested model from published thresholds ({SOLE.source})."
)
"""What the lines of a measured panel are."""


def felt_on(stimuli: Mapping[str, Sequence[Played]], *, rig: Rig, rig_folder: Path) -> dict[str, tuple[Felt, ...]]:
    """Return what a rig's panel makes of what it plays, by material; nothing of each where nobody measured the panel.

    Raises `RigError` for the response.
    """
    if (measured := rig.actuator.measured) is None:
        return dict.fromkeys(stimuli, ())
    movement = open_movement(rig_folder, measured, rate_hz=rig.actuator.rate_hz)
    return {
        material: tuple(movement.felt(one.stimulus.waveform_m_s2, one.samples, ahead=one.ahead) for one in each)
        for material, each in stimuli.items()
    }
