"""The tables of `palpate numerics`."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby

from analysis.numerics import Numerics
from analysis.numerics_invariants import Outcome
from analysis.numerics_measured import BETWEEN_MM_S, OUTPUT_RATE_HZ
from analysis.numerics_timing import Measured, usual_length
from analysis.tables import Section, Table

TITLES = {
    "synthesis": "Synthesis: equations (3) to (5)",
    "resampling": "Resampling of a recording",
    "shaping": "Frequency shaping: the inverse (7) of a response",
    "noise": "Noise of the masker",
}
SAYS = {
    "synthesis": "Error: rms of the difference from the oracle, divided by the rms of the exact stimulus. Prepared: "
    "what is done once for a material, and what it holds then.",
    "resampling": "Error: the same, at samples between both ends. The inverse DCT is what palpate does; the two others "
    "are what it does not do, for comparison.",
    "shaping": "Error: rms of the relative difference from the closed inverse of a response that saturates softly and "
    "peaks at 360 Hz, at the bins from 10 to 600 Hz. It is that of straight lines in a table, no bound is claimed.",
    "noise": "Error: the largest deviation of an octave band from 31.5 Hz to 16 kHz from its colour, against the band "
    "at 1 kHz, dB. Bounded from half a second on.",
}
HEADS = {
    "samples": "N",
    "output_rate_hz": "output rate (Hz)",
    "speed_mm_s": "speed (mm/s)",
    "frequencies": "frequencies",
    "drive_levels": "drive levels",
    "bins": "bins",
    "length_s": "length (s)",
}


def sections(result: Numerics) -> tuple[Section, ...]:
    """Measurements by subject, then the cases."""
    by_subject = groupby(result.measured, key=lambda one: one.subject)
    measured = [_measured(subject, list(rows), result) for subject, rows in by_subject]
    return (*measured, _cases(result.outcomes))


def time_text(seconds: float | None) -> str:
    """A time to three digits; `-` for None."""
    if seconds is None:
        return "-"
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"


def usual(rows: list[Measured]) -> list[Measured]:
    """Of synthesis, what stands for all: one length, one output rate, one speed."""
    wanted = {
        "samples": usual_length(one.given["samples"] for one in rows),
        "output_rate_hz": OUTPUT_RATE_HZ,
        "speed_mm_s": BETWEEN_MM_S,
    }
    return [one for one in rows if one.given == wanted]


def _measured(subject: str, rows: list[Measured], result: Numerics) -> Section:
    paragraphs = [SAYS[subject]]
    if subject == "synthesis":
        software = ", ".join(f"{name} {version}" for name, version in result.software.items() if "oracle" not in name)
        paragraphs.append(
            f"Times are medians of repeats on one machine ({software}); compare them with one another. The oracle's "
            f"numbers are {result.software['oracle_epsilon']} apart at 1."
        )
    tables = [_table("", rows, given=True)]
    brief: tuple[Table, ...] = ()
    if subject == "synthesis":
        shown = usual(rows)
        size = "N = {samples:g} at {output_rate_hz:g} Hz, {speed_mm_s:g} mm/s".format(**shown[0].given)
        brief = (_table(f"{size} (all {len(rows)} rows: --out)", shown, given=False),)
        tables = [_table(size, shown, given=False), replace(tables[0], title="Every size, rate and speed")]
    return Section(
        slug=subject,
        title=TITLES[subject],
        paragraphs=tuple(paragraphs),
        tables=tuple(tables),
        records=tuple(_record(one) for one in rows),
        brief=brief,
    )


def _table(title: str, rows: list[Measured], *, given: bool) -> Table:
    sizes = tuple(rows[0].given) if given else ()
    prepared = any(one.prepared_s is not None for one in rows)
    unit = "error (dB)" if rows[0].subject == "noise" else "error"
    claims = any(one.claimed is not None for one in rows)
    header = ["way", *(HEADS[name] for name in sizes), "median time", unit, *(["claimed"] * claims)]
    header += ["prepared in", "memory"] * prepared
    cells = [
        [
            one.way,
            *(f"{one.given[name]:g}" for name in sizes),
            time_text(one.timed.median_s),
            _error(one, one.error),
            *([_error(one, one.claimed)] * claims),
            *([time_text(one.prepared_s), _kibibytes(one.memory_bytes)] * prepared),
        ]
        for one in rows
    ]
    broken = frozenset((i, header.index(unit)) for i, one in enumerate(rows) if not one.holds)
    return Table(title, tuple(header), tuple(map(tuple, cells)), marked=broken)


def _error(one: Measured, value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if one.subject == "noise" else f"{value:.1e}"


def _kibibytes(size: int | None) -> str:
    return "-" if size is None else f"{size / 1024:.0f} KiB"


def _record(one: Measured) -> dict[str, object]:
    low, high = one.timed.quartiles_s
    return {
        "way": one.way,
        **one.given,
        "median_s": one.timed.median_s,
        "lower_quartile_s": low,
        "upper_quartile_s": high,
        "repeats": one.timed.repeats,
        "error": one.error,
        "claimed_error": one.claimed,
        "holds": one.holds,
        "prepared_s": one.prepared_s,
        "memory_bytes": one.memory_bytes,
    }


def _cases(outcomes: tuple[Outcome, ...]) -> Section:
    full, brief = [], []
    for group, members in groupby(outcomes, key=lambda one: one.group):
        rows = list(members)
        broken = frozenset((i, 2) for i, one in enumerate(rows) if not one.holds)
        cells = tuple((one.given, one.invariant, _outcome(one), one.seen) for one in rows)
        title = f"{group[0].upper()}{group[1:]}"
        header = ("given", "must hold", "outcome", "seen")
        full.append(Table(title, header, cells, left=frozenset({0, 1, 2, 3}), marked=broken))
        brief.append(_brief(title, rows))
    return Section(
        slug="cases",
        title="Extreme cases",
        paragraphs=("Every method at every output rate, and every number that a public function of synthesis takes.",),
        tables=tuple(full),
        records=tuple(
            {
                "group": one.group,
                "given": one.given,
                "invariant": one.invariant,
                "holds": one.holds,
                "seen": one.seen,
            }
            for one in outcomes
        ),
        brief=tuple(brief),
    )


def _outcome(one: Outcome) -> str:
    return "holds" if one.holds else "FAILS"


def _brief(title: str, rows: list[Outcome]) -> Table:
    """For a terminal, where an invariant that all rows share stands in the title."""
    shared = len({one.invariant for one in rows}) == 1
    if shared:
        title = f"{title}: {rows[0].invariant}"
    seen = "seen" if shared else "must hold -> seen"
    cells = tuple((one.given, _outcome(one), one.seen if shared else f"{one.invariant} -> {one.seen}") for one in rows)
    return Table(title, ("given", "outcome", seen), cells, left=frozenset({0, 1, 2}))
