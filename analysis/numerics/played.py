"""What a rig in volts plays: its ways, the errors they claim, condition numbers, and extreme cases.

Voltages are prepared for a material, or shaped for the step, and compared with `oracle.voltages`. All is SIMULATED.
"""

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

from palpate.analysis.numerics import oracle
from palpate.analysis.numerics.cases import AT_SPEED_ROUNDINGS, Case, Seen, material, refused, some
from palpate.analysis.numerics.oracle import PAPER_SAMPLES, RATE_HZ, SPEEDS_MM_S
from palpate.experiment.synthesis.budget import Budget, of_accelerations, of_voltages
from palpate.experiment.synthesis.crinkle import CrinkleSpectra, at_speed
from palpate.experiment.synthesis.shaping import Response, response_at, shape_at
from palpate.experiment.synthesis.spectra import bin_frequencies_hz, spectrum
from palpate.experiment.synthesis.voltages import MISSED, WASTE, Drive, Driven
from palpate.experiment.synthesis.waveforms import ROUNDING, Basis, denormal_error_m_s2, prepare, transform_error

FREQUENCIES_HZ = (*range(10, 30, 2), *range(30, 605, 5))
LEVELS_V = tuple(sqrt(2) * rms for rms in (0.1, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5))
"""Where the simulated panel is measured: like a rig of Okamoto et al., of whom Figure 9 shows 10 to 600 Hz."""


@dataclass(frozen=True, eq=False)
class Rig:
    """A rig in volts: its response, and its limits as `shaping.drive` takes them."""

    response: Response
    rate_hz: int = RATE_HZ
    gain_limit_v_per_m_s2: float = 1.5
    limit_m_s2: float = 30.0
    limit_v: float = 12.0

    def basis(self, spectra: CrinkleSpectra) -> Basis:
        """Return a material, prepared in m/s^2 for this rig's rate."""
        return prepare(spectra, material="simulated", output_rate_hz=self.rate_hz)

    def drive(self, way: str, basis: Basis) -> Drive:
        """Return what plays one material by a way."""
        return Drive(
            {basis.material: basis} if way == PREPARED else {},
            rate_hz=self.rate_hz,
            response=self.response,
            gain_limit_v_per_m_s2=self.gain_limit_v_per_m_s2,
            limit_m_s2=self.limit_m_s2,
            limit_v=self.limit_v,
        )


def panel(frequencies_hz: Sequence[float], levels_v: Sequence[float]) -> Response:
    """Return the simulated panel's response, measured at so many frequencies and levels."""
    f, levels = np.asarray(frequencies_hz, dtype=np.float64), np.asarray(levels_v, dtype=np.float64)
    return Response(f, levels, oracle.answered_m_s2(f[:, None], levels))


RIG = Rig(panel(FREQUENCIES_HZ, LEVELS_V))

PREPARED, SHAPED = "prepared voltages", "voltages shaped for the step"
WAYS = (PREPARED, SHAPED)
"""What sessions do between 0 and 1.5 times the fastest recorded speed where it fits; and what they do elsewhere."""


@dataclass(frozen=True)
class Sensitivity:
    """How a rig's voltages depend on what they are made of, at one speed; arrays have one value a bin within the table.

    `by_amplitude` is the condition number of W(f, a) in a, `by_frequency` that of the table in f; both are 0 at a
    limit. `worst_by_amplitude` is the largest, `rms_by_amplitude` that of all voltages together.
    """

    voltages_v: NDArray[np.float64]
    by_amplitude: NDArray[np.float64]
    by_frequency: NDArray[np.float64]
    beside: NDArray[np.float64]

    @property
    def rms_by_amplitude(self) -> float:
        return _together(self.voltages_v, self.by_amplitude)

    @property
    def worst_by_amplitude(self) -> float:
        return float(self.by_amplitude.max(initial=0.0))


def _together(voltages_v: NDArray[np.float64], of_each: NDArray[np.float64]) -> float:
    largest = np.max(np.abs(voltages_v), initial=0.0)
    if largest == 0:
        return 0.0
    parts = voltages_v / largest
    return float(np.linalg.norm(parts * of_each) / np.linalg.norm(parts))


def sensitivity(spectra: CrinkleSpectra, rig: Rig, *, speed_mm_s: float, scale: float = 1.0) -> Sensitivity:
    """Return how the voltages of a stimulus, taken down to a scale, hang on amplitudes and table."""
    on = spectra.grid(rig.rate_hz)
    at = response_at(rig.response, spectra.samples, spectra.rate_hz, on.carried)
    wanted = at_speed(spectra, speed_mm_s=speed_mm_s).coefficients[: on.carried]
    wanted[0] = 0.0
    shaped = shape_at(wanted, at, gain_limit_v_per_m_s2=rig.gain_limit_v_per_m_s2, scale=scale)
    a, volts = scale * np.abs(wanted[at.known]), np.abs(shaped.coefficients_v[at.known])
    f = np.arange(on.carried)[at.known] * (spectra.rate_hz / (2 * spectra.samples))
    table_hz = rig.response.frequencies_hz
    row = np.clip(np.searchsorted(table_hz, f, side="right") - 1, 0, table_hz.size - 2)
    steps = np.abs(np.diff(rig.response.accelerations_m_s2, axis=0)[row].T)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
        slopes = np.diff(at.levels_v)[:, None] / np.diff(at.curves, axis=0)
        place = (at.curves[1:-1] < a).sum(axis=0)
        by_amplitude = np.take_along_axis(slopes, place[None], axis=0)[0] * (a / volts)
        beside = (steps / at.curves[1:]).max(axis=0, initial=0.0)
    free = (volts > 0) & (a <= at.curves[-1]) & (volts < rig.gain_limit_v_per_m_s2 * a * (1 - 1e-9))
    by_frequency = beside * f / (table_hz[row + 1] - table_hz[row])
    return Sensitivity(volts, *(np.where(free, each, 0.0) for each in (by_amplitude, by_frequency, beside)))


def claim(spectra: CrinkleSpectra, rig: Rig, *, speed_mm_s: float, scale: float = 1.0) -> float:
    """Return the bound on the relative error (rms) of voltages shaped for a step.

    A bin's amplitude is within `AT_SPEED_ROUNDINGS`, and 2 for the scale; the table within 3, the step to the next
    value, and 2 condition numbers in f, weighed by that in a; 6 more are of the inverse, and the transform comes on
    top.
    """
    found = sensitivity(spectra, rig, speed_mm_s=speed_mm_s, scale=scale)
    of_table = 3 + 3 * found.beside + 2 * found.by_frequency
    roundings = np.maximum(found.by_amplitude, 1.0) * (AT_SPEED_ROUNDINGS + 2 + of_table) + 6
    return transform_error(spectra.grid(rig.rate_hz)) + ROUNDING * _together(found.voltages_v, roundings)


@dataclass(frozen=True)
class Compared:
    """Voltages beside the oracle's: error and claim, V, the rms that they are parts of, and what was played."""

    error_v: float
    claim_v: float
    rms_v: float
    driven: Driven


def compare(drive: Drive, basis: Basis, rig: Rig, *, speed_mm_s: float) -> Compared:
    """Compare what a drive plays at a speed with the oracle, which takes the stimulus down as far as the drive did.

    Voltages between two knots may be off by `MISSED` of the largest of their piece besides; that of the step stands
    for it, which claims no more.
    """
    spectra, driven = basis.spectra, drive(basis.at(speed_mm_s))
    exact = oracle.voltages(
        spectra,
        speed_mm_s=speed_mm_s,
        output_rate_hz=rig.rate_hz,
        response=rig.response,
        gain_limit_v_per_m_s2=rig.gain_limit_v_per_m_s2,
        scale=driven.scale,
    )
    if driven.voltages_v.shape != exact.samples.shape:
        raise AssertionError(f"{driven.voltages_v.size} samples, not {exact.samples.size}")
    bound = claim(spectra, rig, speed_mm_s=speed_mm_s, scale=driven.scale)
    rms = float(exact.scale)
    claim_v = bound * rms
    if driven.prepared:
        claim_v += MISSED * float(np.abs(driven.voltages_v).max())
    return Compared(float(oracle.error(driven.voltages_v, exact)), claim_v, rms, driven)


FEET_MM_S = (0.0, 1e-6, 20.0, 50.0, 75.0, 100.0, 170.0, 250.0, 299.0, 300.0, 301.0, 450.0, 451.0, 650.0)
"""Slow feet, the speeds measured, the middle of two of them, the ends of what is prepared, and others."""

FEW_MM_S = (0.0, 75.0, 170.0, 300.0, 451.0)
"""What most cases are tried at; those at all of them are the ones that bend."""

SOME = material(some(PAPER_SAMPLES))
"""N bins at random, of up to 4 m/s^2 each: some 35 m/s^2 rms, as far as the limits of a rig let it through."""


def _scaled(by: float) -> CrinkleSpectra:
    return replace(SOME, amplitudes=SOME.amplitudes * by)


def _free(response: Response) -> Rig:
    """Return a rig whose limits hold nothing back."""
    return Rig(response, gain_limit_v_per_m_s2=1e6, limit_m_s2=inf, limit_v=inf)


def within_claims(rig: Rig, spectra: CrinkleSpectra, speeds_mm_s: Sequence[float] = FEET_MM_S) -> Seen:
    """Compare both ways with the oracle: error, length, limits, and how far prepared voltages are taken down."""
    worst, held, least, basis = 0.0, 0, dict[float, float](), rig.basis(spectra)
    for way in WAYS[::-1]:
        drive = rig.drive(way, basis)
        for v in speeds_mm_s:
            at = f"{way}, {v:g} mm/s"
            found = compare(drive, basis, rig, speed_mm_s=v)
            held += found.driven.prepared
            if not np.abs(found.driven.voltages_v).max() <= rig.limit_v:
                return False, f"{at}: {np.abs(found.driven.voltages_v).max():g} V"
            if not found.driven.scale >= least.setdefault(v, found.driven.scale) * (1 - 2 * WASTE):
                return False, f"{at}: scaled down to {found.driven.scale:g}, not {least[v]:g}"
            allowed = found.claim_v + denormal_error_m_s2(spectra.samples)
            share = found.error_v / allowed
            if not share <= 1:
                return False, f"{at}: {share:.3g} of the error claimed"
            worst = max(worst, share)
    prepared = f"{held} of {len(speeds_mm_s)} speeds prepared"
    return True, f"at most {worst:.3f} of the error claimed; {prepared}" if worst else f"no error at all; {prepared}"


BUDGET_SPEEDS_MM_S = tuple(np.geomspace(20.0, 600.0, 10).tolist())
"""All speeds that the study of Okamoto et al. counts."""

IN_VOLTS, IN_M_S2 = "V", "m/s^2"
FULL_SCALE_M_S2 = 50.0

TRUE = 0.1
"""A budget's total claims to lie within this part of the truth, of which the shares of the table are estimates."""


@dataclass(frozen=True, eq=False)
class Played:
    """One stimulus as a device gets it, in V or m/s^2 (`unit`), float32, shape (n,); its budget, and the truth.

    `truth` is the relative error, rms over all bins, of the simulated panel's motion by its closed form.
    """

    unit: str
    material: str
    speed_mm_s: float
    handed: NDArray[np.float32]
    budget: Budget
    truth: float

    @property
    def holds(self) -> bool:
        """Whether the total is the truth, within `TRUE`."""
        return abs(self.budget.total - self.truth) <= TRUE * self.truth


def play(name: str, spectra: CrinkleSpectra, *, unit: str) -> list[Played]:
    """Return what a rig gets for a material at every speed of a budget, in V, or in m/s^2 up to `FULL_SCALE_M_S2`."""
    basis, found = RIG.basis(spectra), []
    # Prepared voltages are the same, as the cases show, and take seconds to prepare.
    drive = RIG.drive(SHAPED, basis)
    f = bin_frequencies_hz(bins=spectra.samples, rate_hz=spectra.rate_hz)
    for v in BUDGET_SPEEDS_MM_S:
        stimulus = basis.at(v)
        if unit == IN_VOLTS:
            driven = drive(stimulus)
            handed = (driven.voltages_v / RIG.limit_v).astype(np.float32)
            volts, shaped = drive.worked_out(stimulus, driven.scale)
            played_v = handed.astype(np.float64) * RIG.limit_v
            budget = of_voltages(stimulus, handed_v=played_v, voltages_v=volts, shaped=shaped, response=RIG.response)
            moved = oracle.answered_m_s2(f, spectrum(played_v))
        else:
            wanted = stimulus.waveform_m_s2
            handed = (np.clip(wanted, -RIG.limit_m_s2, RIG.limit_m_s2) / FULL_SCALE_M_S2).astype(np.float32)
            played = handed.astype(np.float64) * FULL_SCALE_M_S2
            limited = int(np.count_nonzero(np.abs(wanted) > RIG.limit_m_s2))
            budget = of_accelerations(stimulus, handed_m_s2=played, limited=limited)
            moved = spectrum(played)
        asked = np.asarray(oracle.spectrum_at(spectra, v)[0], dtype=np.float64)
        truth = float(np.linalg.norm(moved[1:] - asked[1:]) / np.linalg.norm(asked[1:]))
        found.append(Played(unit, name, v, handed, budget, truth))
    return found


def arrays(stimuli: Sequence[Played], materials: Mapping[str, CrinkleSpectra]) -> bytes:
    """Return the bytes of a .npz file with everything that it takes to find each truth by other means.

    It contains, for U units, M materials, S recorded and V budget speeds and N bins: `amplitudes` and `signs`, (M, S,
    N), at `recorded_mm_s`; `handed`, V or m/s^2, (U, M, V, N), at `speeds_mm_s`; `units`, `materials`; `total` and
    `truth`, (U, M, V).
    """
    units, names = (list(dict.fromkeys(getattr(one, of) for one in stimuli)) for of in ("unit", "material"))
    shape, full_scale = (len(units), len(names), -1), {IN_VOLTS: RIG.limit_v, IN_M_S2: FULL_SCALE_M_S2}
    place: dict[tuple[str, str], list[Played]] = {(unit, name): [] for unit in units for name in names}
    for one in stimuli:
        place[one.unit, one.material].append(one)
    in_order = [one for each in place.values() for one in each]
    handed = np.stack([one.handed.astype(np.float64) * full_scale[one.unit] for one in in_order])
    file = io.BytesIO()
    np.savez_compressed(
        file, materials=np.array(names), units=np.array(units), rate_hz=RATE_HZ, recorded_mm_s=np.array(SPEEDS_MM_S),
        amplitudes=np.stack([materials[name].amplitudes for name in names]),
        signs=np.stack([materials[name].signs for name in names]).astype(np.int8),
        speeds_mm_s=np.array(BUDGET_SPEEDS_MM_S), handed=handed.reshape(*shape, handed.shape[-1]),
        total=np.reshape([one.budget.total for one in in_order], shape),
        truth=np.reshape([one.truth for one in in_order], shape),
    )  # fmt: skip
    return file.getvalue()


@dataclass(frozen=True)
class Condition:
    """A condition number: what hangs `on` what, the largest found, and `where` it was."""

    of: str
    on: str
    number: float
    where: str


def conditions(materials: Mapping[str, CrinkleSpectra], speeds_mm_s: Sequence[float]) -> tuple[Condition, ...]:
    """Return condition numbers, rms to rms, of what is played, each the largest over materials and speeds."""
    found: dict[tuple[str, str], tuple[float, str]] = {}
    for name, spectra in materials.items():
        for v in speeds_mm_s:
            of_rig = sensitivity(spectra, RIG, speed_mm_s=v)
            numbers = {
                ("stimulus", "speed of the foot"): _by_speed(spectra, v),
                ("stimulus", "the two waveforms that it is the sum of"): _cancelled(RIG.basis(spectra), v),
                ("voltages", "requested amplitudes, and values of the table"): of_rig.rms_by_amplitude,
                ("voltages, in one bin", "its amplitude, and values of the table"): of_rig.worst_by_amplitude,
                ("response at a bin", "frequencies of the table"): float(of_rig.by_frequency.max(initial=0.0)),
            }
            for key, number in numbers.items():
                found[key] = max(found.get(key, (0.0, "")), (number, f"{name}, {v:g} mm/s"))
    return tuple(Condition(*key, *value) for key, value in found.items())


def _by_speed(spectra: CrinkleSpectra, speed_mm_s: float) -> float:
    """Return v |dC'/dv| / |C'|: of the nearer side, for signs that change in the middle of two speeds are no slope."""
    near = np.abs(at_speed(spectra, speed_mm_s=speed_mm_s).coefficients[1:])
    beside = np.abs(at_speed(spectra, speed_mm_s=speed_mm_s * (1 + 1e-6)).coefficients[1:])
    return float(np.linalg.norm(beside - near) / np.linalg.norm(near) / 1e-6)


def _cancelled(basis: Basis, speed_mm_s: float) -> float:
    stimulus = basis.at(speed_mm_s)
    if not stimulus.held:
        return 1.0
    terms = basis.pairs[stimulus.interval][stimulus.nearer]
    sizes = np.array([1.0, abs(stimulus.of_difference)]) * np.linalg.norm(terms, axis=1)
    return float(sizes.sum() / np.linalg.norm(stimulus.waveform_m_s2))


def jump(spectra: CrinkleSpectra) -> float:
    """Return how far a stimulus jumps where its signs change in the middle of two speeds: rms, as a part of its own."""
    speeds, jumps = spectra.speeds_mm_s, list[float]()
    for slow, fast in pairwise(speeds.tolist()):
        middle = (slow + fast) / 2
        below, above = (
            at_speed(spectra, speed_mm_s=float(v)).coefficients[1:] for v in (middle, np.nextafter(middle, inf))
        )
        jumps.append(float(np.linalg.norm(above - below) / np.linalg.norm(below)))
    return max(jumps)


def cases() -> list[Case]:
    """Return every case of what a rig in volts plays, of recordings with as many bins as a study has."""
    keeps = "finite and within the limits; prepared or shaped, within the claimed error"
    null = panel(FREQUENCIES_HZ, LEVELS_V)
    null.accelerations_m_s2[FREQUENCIES_HZ.index(300)] = 0.0
    steep = Response(np.array([10.0, 600.0]), np.array([1.0, 2.0, 3.0]), np.array([[1.0, 1.0 + 1e-9, 2.0]] * 2))
    coarse, one_level = panel((10, 600), LEVELS_V), panel(FREQUENCIES_HZ, (0.5,))
    quiet, knots = _scaled(0.02), _scaled(0.1)
    one_bin = replace(SOME, amplitudes=SOME.amplitudes * np.where(np.arange(PAPER_SAMPLES) == 200, 1e300, 0.0))
    given: tuple[tuple[str, Rig, CrinkleSpectra], ...] = (
        ("silence", RIG, _scaled(0.0)), ("1e300 m/s^2", replace(RIG, rate_hz=48_000), _scaled(1e300)),
        ("1e300 m/s^2 in one bin", RIG, one_bin), ("denormals", RIG, _scaled(1e-321)),
        ("below the lowest level", RIG, quiet),
        ("far above the limit of the panel", replace(RIG, rate_hz=48_000), SOME),
        ("above the limit of the panel", replace(RIG, limit_m_s2=3.0), quiet),
        ("no limit", _free(RIG.response), SOME),
        ("a gain limit that holds most bins back", replace(RIG, gain_limit_v_per_m_s2=0.05), knots),
        ("an amplifier of 0.5 V", replace(RIG, limit_v=0.5), knots), ("two frequencies", Rig(coarse), knots),
        ("one level", Rig(one_level), knots),
        ("a level that hardly exceeds the one below", _free(steep), knots),
        ("an output of 1 kHz", replace(RIG, rate_hz=1000), knots),
        ("an output of 44.1 kHz", replace(RIG, rate_hz=44_100), quiet),
    )  # fmt: skip
    places = [float(np.nextafter(v, towards)) for v in (*SPEEDS_MM_S, 75.0) for towards in (0.0, inf)]
    refusals = "refused with SynthesisError"
    return [
        *(Case("volts", name, keeps, partial(within_claims, rig, spectra, FEW_MM_S)) for name, rig, spectra in given),
        Case("volts", "levels exceeded by most bins", keeps, partial(within_claims, RIG, knots)),
        Case("volts", "a null at 300 Hz, and bins next to it", keeps, partial(within_claims, Rig(null), knots)),
        Case("volts", "one rounding step from speeds", keeps, partial(within_claims, RIG, knots, places)),
        Case("volts", "one recorded speed", refusals, _one_speed),
        Case("volts", "a foot speed of -1, NaN or infinite mm/s", refusals, _no_foot),
    ]


def _one_speed() -> Seen:
    one = np.ones((1, PAPER_SAMPLES))
    return refused([("one speed", lambda: CrinkleSpectra(np.array([100.0]), RATE_HZ, one, one))])


def _no_foot() -> Seen:
    def play(speed_mm_s: float) -> Callable[[], object]:
        basis = RIG.basis(SOME)
        return lambda: RIG.drive(SHAPED, basis)(basis.at(speed_mm_s))

    return refused([(f"{v:g} mm/s", play(v)) for v in (-1.0, float("nan"), inf)])
