"""What `palpate numerics` prints and writes: tables, JSON, plots of error against run time and of the budget."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from itertools import groupby
from math import isnan, nan
from pathlib import Path
from typing import Any

from palpate.analysis.documents.drawing import png, svg
from palpate.analysis.documents.output import check, publish
from palpate.analysis.documents.tables import (
    WIDTH,
    Column,
    Record,
    Section,
    Table,
    blocks,
    comma_separated,
    markdown,
    tabulate,
)
from palpate.analysis.documents.tables import text as section_text
from palpate.analysis.numerics import contact, figures, force, played
from palpate.analysis.numerics.cases import Outcome
from palpate.analysis.numerics.figures import time_text
from palpate.analysis.numerics.force import Pushed
from palpate.analysis.numerics.numerics import (
    AS_GOOD,
    BETWEEN_MM_S,
    LABEL,
    MATERIALS,
    NO_ANSWER,
    OUTPUT_RATE_HZ,
    OUTSIDE_MM_S,
    WITHIN_MM_S,
    Measured,
    Numerics,
    dominated,
    shaping_order,
    usual_length,
)
from palpate.analysis.numerics.oracle import PAPER_SAMPLES
from palpate.analysis.numerics.played import FULL_SCALE_M_S2, Played
from palpate.experiment.errors import DatasetError
from palpate.experiment.synthesis.contact.sampled import of_the_paper
from palpate.experiment.synthesis.signals.noise import CLAIMED_FROM_S

TITLES = {
    "synthesis": "Synthesis: equations (3) to (5)",
    "voltages": "Voltages: equations (3) to (5) and (7)",
    "samples": "Samples: the signal sent to a device",
    "resampling": "Resampling of a recording",
    "shaping": "Frequency shaping: the inverse (7) of a response",
    "noise": "Noise of the masker",
    "contact": "Contact with a virtual block: equations (4) and (5) of Wellman and Howe",
}
LABELS = {
    "resampling": "SIMULATED recordings", "shaping": "SIMULATED responses", "noise": "SIMULATED noise",
    "contact": "SIMULATED contacts", "force": "SIMULATED devices", "cases": "SIMULATED cases",
}  # fmt: skip
"""The labels of tables without spectra."""

FILES = (
    *(f"{slug}.csv" for slug in (*TITLES, "conditions", "budget", "force", "cases")),
    *(f"{name}.{kind}" for name in ("numerics", "contact", "budget") for kind in ("svg", "png")),
    *("numerics.md", "methods.md", "played.npz", "force.npz"),
)
"""The files that `write` writes."""

USUAL_FREQUENCIES = 120
"""Of a response table: every 5 Hz to 600 Hz."""

ABOUT = blocks(Path(__file__).with_name("about.md"))
COUNTED = {
    "materials": len(MATERIALS), "within": len(WITHIN_MM_S), "outside": len(OUTSIDE_MM_S),
    "speeds": len(WITHIN_MM_S) + 2, "full_scale": f"{FULL_SCALE_M_S2:g}", "damping_ratio": f"{contact.DAMPING_RATIO:g}",
    "sole": f"{figures.UNNOTICED[0]:.1e}", "fingertip": f"{figures.UNNOTICED[1]:.1e}",
}  # fmt: skip
"""What the texts name."""
HEADS = {
    "samples": "N", "output_rate_hz": "output rate (Hz)", "speed_mm_s": "speed (mm/s)", "frequencies": "frequencies",
    "drive_levels": "drive levels", "bins": "bins", "length_s": "length (s)", "stiffness_n_m": "K (N/m)",
    "mass_kg": "M (kg)", "step_s": "step (s)", "release_error": "of release", "penetration_error": "of penetration",
    "energy_error": "of energy", "prepared_share": "prepared",
}  # fmt: skip


def sections(result: Numerics) -> tuple[Section, ...]:
    """Return the measurements by subject, condition numbers, the budget, and the cases."""
    by_subject = groupby(result.measured, key=lambda one: one.subject)
    measured = [_measured(subject, list(rows), result) for subject, rows in by_subject]
    return (*measured, _conditions(result), _budget(result.played), _force(result.pushed), _cases(result.outcomes))


def text(result: Numerics) -> str:
    """Return everything for a terminal, with the verdict at the end."""
    verdict = (textwrap.fill(line, WIDTH, subsequent_indent="    ") for line in result.verdict.splitlines())
    return "\n\n\n".join([LABEL, *(section_text(one) for one in sections(result)), "\n".join(verdict)])


def as_dict(result: Numerics) -> dict[str, Any]:
    """Return every number and outcome, for JSON."""
    rows = {section.slug: [dict(record) for record in section.records] for section in sections(result)}
    return {"label": LABEL, "software": result.software, "failed": result.failed, "broken": list(result.broken), **rows}


def check_out(out: Path) -> None:
    """Refuse, before anything is measured, a folder that `write` could not write into.

    Raises `DatasetError` if the folder is within a dataset, a file is in the way, or the file system refuses.
    """
    check(out, FILES, "numerics")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DatasetError(
            f"cannot write {error.filename or out}: {error.strerror}", remedy="choose another --out"
        ) from error


def write(result: Numerics, out: Path) -> tuple[Path, ...]:
    """Write tables (CSV, Markdown) and the plot (PNG, SVG) into a folder; return the files. Errors as `check_out`."""
    check(out, FILES, "numerics")
    parts = sections(result)
    files = {f"{part.slug}.csv": comma_separated(part, LABELS.get(part.slug, LABEL)).encode() for part in parts}
    page = [f"**{LABEL}**\n", *(markdown(part, "") for part in parts), result.verdict, ""]
    files["numerics.md"] = "\n".join(page).encode()
    drawn = {
        "numerics": figures.numerics(result),
        "contact": figures.diagrams(_contact(result)),
        "budget": figures.budget(result.played),
    }
    files |= {f"{name}.svg": svg(each) for name, each in drawn.items()}
    files |= {f"{name}.png": png(each) for name, each in drawn.items()}
    files["methods.md"] = markdown(methods(result), "").encode()
    files["played.npz"] = played.arrays(result.played, result.materials)
    files["force.npz"] = force.arrays(result.pushed)
    return publish(out, files, LABEL, "numerics")


def _contact(result: Numerics) -> list[Measured]:
    return [one for one in result.measured if one.subject == "contact"]


DOMINATED = (
    "A method is dominated if another does the same in less time (the quartiles do not overlap) with an error at "
    f"most {AS_GOOD:g} times as large. A method whose error is {NO_ANSWER:g} or more is also dominated."
)


def _measured(subject: str, rows: list[Measured], result: Numerics) -> Section:
    paragraphs = [ABOUT[subject].substitute(COUNTED)]
    if dominated(rows[0], rows) is not None:
        paragraphs.append(DOMINATED)
    if subject == "synthesis":
        software = ", ".join(f"{name} {version}" for name, version in result.software.items() if "oracle" not in name)
        paragraphs.append(
            f"Times are medians of repeats on one machine ({software}) and should only be compared with each other. "
            f"Near 1, the oracle's numbers are {result.software['oracle_epsilon']} apart."
        )
    tables = [_table("", rows, given=True)]
    brief: tuple[Table, ...] = ()
    if subject == "synthesis":
        shown = _usual(subject, rows)
        size = "N = {samples:g} at {output_rate_hz:g} Hz, {speed_mm_s:g} mm/s".format(**shown[0].given)
        brief = (_table(f"{size} (all {len(rows)} rows: --out)", shown, given=False),)
        usual = replace(_table(size, shown, given=False), records=())
        tables = [usual, replace(tables[0], title="Every size, rate and speed")]
    if subject == "shaping" and (fitted := shaping_order(rows)) is not None:
        paragraphs.append(
            f"Between the frequencies of the table, the error falls with the power {fitted:.2f} of their spacing, "
            "fitted where it is below 0.05; straight lines give 2."
        )
    if subject == "contact":
        paragraphs += [figures.orders(rows), of_the_paper()]
        shown = [one for one in rows if one.given["step_s"] == contact.SERVO_S]
        title = f"At the servo's step of {contact.SERVO_S * 1e6:g} µs (all {len(rows)} rows: --out)"
        brief = (_table(title, shown, given=True),)
    return Section(subject, TITLES[subject], tuple(paragraphs), tuple(tables), brief=brief)


def _table(title: str, rows: list[Measured], *, given: bool) -> Table:
    first = rows[0]
    error = Column("error", "error (dB)" if first.subject == "noise" else "error", show=partial(_error, first.subject))
    columns = [Column("way", left=True)]
    if given:
        columns += [
            Column(name, HEADS[name], show=("{:.3g}" if name == "step_s" else "{:g}").format) for name in first.given
        ]
    columns += [Column("median_s", "median time", show=time_text), error]
    if any(one.claimed is not None for one in rows):
        columns.append(Column("claimed_error", "claimed", show=error.show))
    columns += [Column(name, HEADS[name], show="{:.0%}".format if "share" in name else error.show)
                for name in first.others]  # fmt: skip
    if any(one.prepared_s is not None for one in rows):
        columns += [Column("prepared_s", "prepared in", show=time_text), Column("memory_bytes", "memory", show=_memory)]
    if dominated(first, rows) is not None:
        columns.append(DOMINATED_COLUMN)
    broken = frozenset((place, columns.index(error)) for place, one in enumerate(rows) if not one.holds)
    records = [_record(one) | {"dominated": dominated(one, rows)} for one in rows]
    return tabulate(title, columns, records, marked=broken, in_print={"dominated"})


def _error(subject: str, value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if subject == "noise" else f"{value:.1e}"


def _memory(size_bytes: int | None) -> str:
    return "-" if size_bytes is None else f"{size_bytes / 1024:.0f} KiB"


def _yes_or_no(value: bool | None) -> str:
    return "-" if value is None else "yes" if value else "no"


DOMINATED_COLUMN = Column("dominated", show=_yes_or_no)


def _record(one: Measured) -> dict[str, Any]:
    low, high = one.timed.quartiles_s
    return {
        "way": one.way, **one.given, "median_s": one.timed.median_s, "lower_quartile_s": low,
        "upper_quartile_s": high, "repeats": one.timed.repeats, "error": one.error, "claimed_error": one.claimed,
        **one.others, "worst_at": one.worst_at or None, "holds": one.holds, "prepared_s": one.prepared_s,
        "memory_bytes": one.memory_bytes,
    }  # fmt: skip


GIVEN = Column("given", left=True)
OUTCOME = Column("holds", "outcome", show=lambda holds: "holds" if holds else "FAILS", left=True)
SEEN = Column("seen", left=True)
CASES = (GIVEN, Column("invariant", "must hold", left=True), OUTCOME, SEEN)
BOTH = Column(("invariant", "seen"), "must hold -> seen", show=lambda *of: " -> ".join(of), left=True)


def _cases(outcomes: tuple[Outcome, ...]) -> Section:
    full, brief = [], []
    for group, members in groupby(outcomes, key=lambda one: one.group):
        records = [asdict(one) for one in members]
        broken = frozenset((i, 2) for i, one in enumerate(records) if not one["holds"])
        title = f"{group[0].upper()}{group[1:]}"
        full.append(tabulate(title, CASES, records, marked=broken))
        # In a terminal an invariant that all rows share stands in the title.
        shared = len({one["invariant"] for one in records}) == 1
        named = f"{title}: {records[0]['invariant']}" if shared else title
        brief.append(tabulate(named, (GIVEN, OUTCOME, SEEN if shared else BOTH), records))
    about = (
        f"Stimuli have as many bins as in a study, N = {PAPER_SAMPLES}, except in cases of other lengths and of the "
        "printed sum. The cases test each method at every output rate, what a stimulus states about itself, what a "
        "rig in volts plays, and the oracle against itself."
    )
    return Section("cases", "Extreme cases", (about,), tuple(full), brief=tuple(brief))


def _budget(result: Sequence[Played]) -> Section:
    speeds = played.BUDGET_SPEEDS_MM_S
    about = (
        ABOUT["budget"].substitute(
            count=len(speeds), slowest=f"{speeds[0]:g}", fastest=f"{speeds[-1]:g}", within=f"{played.TRUE:.0%}"
        ),
        "The played signals are in played.npz, so the truth can be checked with other software; "
        "`tests/README.md` in palpate's repository shows how.",
    )
    tables = []
    for unit in dict.fromkeys(one.unit for one in result):
        names = list(dict.fromkeys(one.material for one in result))
        of = {name: [one for one in result if (one.unit, one.material) == (unit, name)] for name in names}
        shares: list[Record] = [
            {"cause": label, **{name: [getattr(one.budget, cause) for one in of[name]] for name in names}}
            for cause, label in {**figures.CAUSES, "total": "all of it"}.items()
        ]
        shares.append({"cause": "truth", **{name: [one.truth for one in of[name]] for name in names}})
        columns = Column("cause", left=True), *(Column(name, show=_range) for name in names)
        tables.append(replace(tabulate(f"A rig in {unit}", columns, shares), records=()))
    records = tuple(
        {"unit": one.unit, "material": one.material, "speed_mm_s": one.speed_mm_s, **asdict(one.budget),
         "left_out": one.budget.left_out, "total": one.budget.total, "truth": one.truth, "holds": one.holds}
        for one in result
    )  # fmt: skip
    return Section("budget", "Error budget of the played signal", about, tuple(tables), records)


def _force(result: Sequence[Pushed]) -> Section:
    known = {
        **{name: f"{value:g}" for name, value in force.HAND.items()}, "within": f"{force.TRUE:.0%}",
        "limit": f"{force.LIMIT_N:g}", "stiffness": f"{force.STIFFNESS_N_M:g}", "damping": f"{force.DAMPING_N_S_M:g}",
        "rate": force.RATE_HZ, "told": f"{force.TOLD_KG:g}", "noise": f"{force.NOISE_M * 1e6:g}",
        "count": f"{force.COUNT_M * 1e6:g}", "fine": force.FINE,
    }  # fmt: skip
    about = tuple(ABOUT[name].substitute(known) for name in ("force", "force by hand"))
    tables, records = [], list[Record]()
    for one in result:
        rows = one.budget.rows()
        heads = [str(name) for name in rows[0]][1:]
        by_cause = [
            {"cause": f"truth, {cause}"}
            | {head: true.get(cause, nan) for head, true in zip(heads, one.truth, strict=True)}
            for cause in one.truth[-1]
        ]
        columns = Column("cause", left=True), *(Column(head, show=_percent) for head in heads)
        tables.append(replace(tabulate(f"A device of {one.name}", columns, [*rows, *by_cause]), records=()))
        records += [
            {"device": one.name, "speed_mm_s": felt.speed_mm_s, "cause": cause, "error": error,
             "truth": true.get(cause)}
            for felt, true in zip(one.budget.felt, one.truth, strict=True)
            for cause, error in felt.errors.items()
        ]  # fmt: skip
    return Section("force", "Error budget of the force", about, tuple(tables), tuple(records))


def _percent(share: float) -> str:
    return "-" if isnan(share) else f"{share:.1%}"


def _range(shares: Sequence[float]) -> str:
    low, high = (f"{100 * share:.1g}" if share < 1e-5 else f"{100 * share:.3g}" for share in (min(shares), max(shares)))
    return low if low == high else f"{low} to {high}"


def _conditions(result: Numerics) -> Section:
    about = (
        "How much a relative error (rms) in one quantity is amplified in the other: the largest value over the "
        "materials at speeds from 20 to 400 mm/s, and over the stiffnesses of a contact. For recorded amplitudes, "
        "every stimulus has a condition number of 1.",
        "Midway between two recorded speeds, where equation (4) changes sign, a stimulus has no condition number: "
        f"the next speed plays a waveform that differs by {result.jump:.0%} (rms).",
    )
    columns = (
        Column("of", left=True), Column("on", left=True),
        Column("number", "condition number", show="{:.3g}".format), Column("where", "largest at", left=True),
    )  # fmt: skip
    return Section("conditions", "Condition numbers", about, (tabulate("", columns, map(asdict, result.conditions)),))


def methods(result: Numerics) -> Section:
    """Return the tables of `tests/benchmarks/results`: each method at the usual sizes, and contact by the servo."""
    of_contact = _contact(result)
    rows = [one for one in result.measured if one.subject != "contact"]
    shown = [one for subject, each in groupby(rows, key=lambda one: one.subject) for one in _usual(subject, list(each))]
    records: list[Record] = [
        {"of": one.subject, "given": one.given, "dominated": dominated(one, shown)} | _record(one) for one in shown
    ]
    diagrams = dict.fromkeys((one.given["stiffness_n_m"], one.given["mass_kg"]) for one in of_contact)
    by_place = {
        (one.way, one.given["stiffness_n_m"]): one for one in of_contact if one.given["step_s"] == contact.SERVO_S
    }
    heads = {stiffness: f"{stiffness:g} N/m, {mass:g} kg" for stiffness, mass in diagrams}
    steps: list[Record] = [
        {"method": way, **{head: by_place[way, stiffness] for stiffness, head in heads.items()}}
        for way in dict.fromkeys(one.way for one in of_contact)
    ]
    columns = Column("method", left=True), *(Column(head, show=_error_and_time) for head in heads.values())
    servo = replace(tabulate(f"Contact in steps of {contact.SERVO_S * 1e6:g} µs", columns, steps), records=())
    return Section("methods", "Methods", tables=(tabulate("", METHODS, records), servo))


def _error_and_time(one: Measured) -> str:
    error = "wrong" if one.error >= NO_ANSWER else f"{one.error:.1e}"
    return f"{error}, {time_text(one.timed.median_s)}"


def _usual(subject: str, rows: list[Measured]) -> list[Measured]:
    """Return the rows of a subject at the usual sizes, which stand for all."""
    usual_samples = usual_length(one.given.get("samples", 0) for one in rows)
    wanted: dict[str, dict[str, float]] = {
        "synthesis": {"samples": usual_samples, "output_rate_hz": OUTPUT_RATE_HZ, "speed_mm_s": BETWEEN_MM_S},
        "voltages": {"samples": usual_samples},
        "resampling": {"output_rate_hz": OUTPUT_RATE_HZ},
        "shaping": {"frequencies": USUAL_FREQUENCIES},
        "noise": {"length_s": CLAIMED_FROM_S},
    }
    sizes = wanted.get(subject, {}).items()
    return [one for one in rows if sizes <= one.given.items()]


def _error_with_unit(subject: str, value: float | None) -> str:
    return f"{_error(subject, value)} dB" if subject == "noise" and value is not None else _error(subject, value)


def _sizes(given: Mapping[str, float]) -> str:
    return ", ".join(f"{value:g} {UNITS[name]}" for name, value in given.items() if name in UNITS)


UNITS = {"samples": "bins", "output_rate_hz": "Hz", "speed_mm_s": "mm/s", "frequencies": "frequencies", "length_s": "s"}
METHODS = (
    Column("of", left=True), Column("way", left=True), Column("given", "at", show=_sizes, left=True),
    Column("median_s", "median time", show=time_text), Column(("of", "error"), "error", show=_error_with_unit),
    Column(("of", "claimed_error"), "claimed", show=_error_with_unit), DOMINATED_COLUMN,
)  # fmt: skip
