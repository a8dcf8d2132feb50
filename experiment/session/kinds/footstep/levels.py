"""A step's stimulus at a level: the whole spectrum multiplied by it, and prepared anew before the foot is waited for.

`trials` looks this up for a task with levels. Preparing anew, and not multiplying what is prepared, leaves the bounds
on the error of a waveform as they are. On a rig that takes volts, whose voltages do not grow with the vibration alone,
nothing is prepared under another name, so that each step is shaped by itself.
"""

from dataclasses import replace

from palpate.experiment.session.kinds.footstep.watch import Watch
from palpate.experiment.synthesis.crinkle import CrinkleSpectra
from palpate.experiment.synthesis.waveforms import Basis, prepare


def at_level(watch: Watch, material: str, level: float) -> Watch:
    """Return what a step is watched with whose stimulus is that of a material, at a level."""
    if watch.sounder is None:
        return watch
    materials = watch.sounder.materials
    leveled = scaled(materials[material], level)
    return replace(watch, sounder=replace(watch.sounder, materials={**materials, material: leveled}))


def scaled(basis: Basis, level: float) -> Basis:
    """Return a material whose vibrations are those of another, multiplied by a level."""
    named = f"{basis.material} at level {level!r}"
    return prepare(_multiplied(basis.spectra, level), material=named, output_rate_hz=basis.output_rate_hz)


def _multiplied(spectra: CrinkleSpectra, level: float) -> CrinkleSpectra:
    left_out = spectra.left_out
    if left_out is not None:
        left_out = replace(left_out, products=left_out.products * level**2, sums=left_out.sums * level)
    return replace(spectra, amplitudes=spectra.amplitudes * level, left_out=left_out)
