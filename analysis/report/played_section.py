"""What was played: how far the stimuli of a study are from what was asked for, by task and material."""

from collections import Counter

import pandas as pd

from palpate.analysis.documents.tables import Column, Record, Section, number, plural, tabulate
from palpate.analysis.reading.files import MISSING
from palpate.analysis.reading.study import Study
from palpate.analysis.report.heard import UNHEARD, UNLISTENED, heard_tables
from palpate.experiment.synthesis.noticing import SOLE, noticed_where_alike

LITTLE = 5e-6
"""Shares below are shown as less than 0.001 %."""

MUCH = 0.01
"""What was changed besides is told from this share on."""

PRACTICED = " This rig is simulated, so practice is allowed, but study sessions that exceed left_out_max are not."

ABOUT = (
    "This section compares the signal sent to the actuator with the signal that equations (1) to (5) request, in "
    'every attempt of the participants analyzed. "Error" and "left out" are medians, as a percentage of the '
    "requested rms. A panel driven in volts is assumed to respond to each frequency separately, with a real gain; "
    "phase is ignored."
)


def played_sections(study: Study) -> tuple[Section, ...]:
    """Return the section, of every attempt of those analysed, or none where no stimulus has its error on record."""
    known = _known(study)
    if known.empty:
        return ()
    records = [
        _record(task.id, material, rows)
        for task in study.tasks
        for material in study.materials
        if not (rows := known[(known["task"] == task.id) & (known["presented"] == material)]).empty
    ]
    heard = heard_tables(study, known)
    return (
        Section(
            "played",
            "What was played",
            (
                ABOUT,
                *(left_out(study) or ("The rig delivered the whole requested signal.",)),
                *([UNHEARD] if known["delivered"].isna().all() else ()),
                *(() if heard else (UNLISTENED,)),
            ),
            (tabulate("Stimuli, by task and material", STIMULI, records, (_methods(known),)), *heard),
        ),
    )


def left_out(study: Study) -> tuple[str, ...]:
    """Return in a sentence what the rig left out at most of what was asked for, or nothing where that is little."""
    known = _known(study)
    if known.empty:
        return ()
    most = known.sort_values("left_out").iloc[-1]
    less = bool(most["left_out"] >= LITTLE)
    speed = "" if pd.isna(most["foot_speed_mm_s"]) else f" at {most['foot_speed_mm_s']:.0f} mm/s"
    changed = (known["stimulus_error"] ** 2 - known["left_out"] ** 2).clip(lower=0.0).max() ** 0.5
    told = [
        f"The rig could not deliver the whole requested signal: up to {_percent(most['left_out'])} % of a vibration "
        f"(rms) was left out, for {most['presented']}{speed}."
    ] * less
    if changed >= MUCH:
        what = "The limits of panel and amplifier, and the response table"
        off = _percent(known["stimulus_error"].max())
        told.append(f"{what}, changed up to {_percent(changed)} % of a vibration; the total error was up to {off} %.")
    about = "Participants felt the vibration as played, and their answers refer to that."
    practiced = PRACTICED * (less and study.origin == "PRACTICE")
    return (" ".join([*told, about]) + practiced,) if told else ()


def _known(study: Study) -> pd.DataFrame:
    used = study.of_analysed()
    return used[used["stimulus_error"].notna()]


def _methods(known: pd.DataFrame) -> str:
    counts = Counter(known.loc[known["stimulus_method"] != MISSING, "stimulus_method"])
    told = "; ".join(f"{method}: {plural(times, 'time')}" for method, times in sorted(counts.items()))
    off = float(known["stimulus_error"].max())
    often = f"{noticed_where_alike(off, SOLE) * 100:.0f} %"
    return (
        f"How the samples were made: {told}. According to a model (`palpate plan` has its sources), a person notices "
        f"the largest error, {_percent(off)} %, in up to {often} of comparisons if it is the same in all third "
        "octaves. Dissimilarity follows equation (6), in m/s^2; the columns give the median and the largest. "
        'Stimulus onsets are in the section "Course of the tasks".'
    )


def _percent(share: float) -> str:
    return "< 0.001" if 0 < share < LITTLE else number(float(share) * 100, 2)


STIMULI = (
    Column("task", left=True), Column("presented", left=True), Column("attempts"),
    Column("error_median", "error %", show=_percent), Column("error_max", "most", show=_percent),
    Column("left_out_median", "left out %", show=_percent), Column("left_out_max", "most", show=_percent),
    Column("dissimilarity_m_s2_median", "dissimilarity"), Column("dissimilarity_m_s2_max", "most"),
)  # fmt: skip


def _record(task: str, material: str, rows: pd.DataFrame) -> Record:
    columns = {"error": "stimulus_error", "left_out": "left_out", "dissimilarity_m_s2": "dissimilarity_m_s2"}
    medians = {f"{name}_median": float(rows[column].median()) for name, column in columns.items()}
    largest = {f"{name}_max": float(rows[column].max()) for name, column in columns.items()}
    return {"task": task, "presented": material, "attempts": len(rows), **medians, **largest}
