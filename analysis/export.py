"""Study -> tables for other software, with a dictionary of every column.

`trials.csv` is tidy, with one row for each attempt. R reads `long.csv`, the counts by participant and cell. JASP reads
`wide.csv` for repeated measures, with one row for each participant. `psychopy.csv` has the columns of PsychoPy's own
data files. Of comparisons there are `trials.csv` and `pairs.csv`, the counts by participant and ordered pair. Files are
UTF-8 with commas; a missing value is NA, or empty for PsychoPy; an apostrophe stands before a text that a spreadsheet
would compute.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from analysis.documents.output import check, publish
from analysis.documents.tables import cell
from analysis.identification.confusion import confusion_of
from analysis.reading.dataset import MISSING, read_pooled
from analysis.reading.study import Study
from experiment.records import tapping
from experiment.records.events import NO_ANSWER

LABEL = ("dataset", "what the rows are: 'measured', or that they are simulated, reconstructed or imported", "text")
PARTICIPANT = ("participant", "label of the participant as in BIDS, which no software takes for a number", "text")
TASK = ("task", "id of the task", "text")
WHOSE = (LABEL, PARTICIPANT, TASK)
ATTEMPT = (
    *WHOSE,
    ("trial", "place of the trial in its order, from 1", "whole number"),
    ("attempt", "1 for the first attempt at this trial", "whole number"),
    ("counted", "1: the attempt that counts; 0: done again", "0 or 1"),
    ("included", "1: in the analysis; 0: left out, see exclusions.csv", "0 or 1"),
)
PRESENTED = ("presented", "material presented", "text")
ATTEMPT = (
    LABEL,
    PARTICIPANT,
    TASK,
    ("trial", "place of the trial in its order, from 1", "whole number"),
    ("attempt", "1 for the first attempt at this trial", "whole number"),
    ("counted", "1: the attempt that counts; 0: done again", "0 or 1"),
    ("included", "1: in the analysis; 0: left out, see exclusions.csv", "0 or 1"),
)

ATTEMPT = (
    LABEL,
    PARTICIPANT,
    TASK,
    ("trial", "place of the trial in its order, from 1", "whole number"),
    ("attempt", "1 for the first attempt at this trial", "whole number"),
    ("counted", "1: the attempt that counts; 0: done again", "0 or 1"),
    ("included", "1: in the analysis; 0: left out, see exclusions.csv", "0 or 1"),
)

COLUMNS: Mapping[str, tuple[tuple[str, str, str], ...]] = {
    "trials.csv": (
        *ATTEMPT,
        PRESENTED,
        ("answered", f"material named; {NO_ANSWER}: none was named", "text"),
        ("correct", "1: the material presented was named; NA: the attempt has no answer yet", "0 or 1"),
        ("response_time_s", "contact of the foot to the confirmed answer; imported: as measured elsewhere", "seconds"),
        ("foot_speed_mm_s", "10 mm divided by the time from 20 to 10 mm above the panel", "mm/s"),
        ("frames_lost", "tracker frames lost or damaged between arming and contact", "whole number"),
        ("onset_error_s", "measured onset of the stimulus at the panel minus contact", "seconds"),
        ("prediction_error_s", "contact as predicted before the point of no return minus actual contact", "seconds"),
        ("delivery_error_s", "measured onset of the stimulus at the panel minus the onset asked for", "seconds"),
        ("gate_to_scheduled_s", "arrival of the frame that gave the gate to the onset first scheduled", "seconds"),
        ("stimulus_error", "rms of the difference of what was handed to the actuator from what was asked for", "share"),
        ("left_out", "rms of what the rig did not carry", "share of the rms asked for"),
        ("dissimilarity_m_s2", "equation (6) between what was handed to the actuator and what was asked for", "m/s^2"),
        ("dead_time_s", "confirmed answer to the trial before to this attempt armed", "seconds"),
        ("first_task", "the task that the participant did first", "text"),
    ),
    "long.csv": (
        *WHOSE,
        PRESENTED,
        ("answered", f"material named; {NO_ANSWER}: none was named", "text"),
        ("count", "included trials with this answer", "whole number"),
        ("trials", "included trials with this material", "whole number"),
        ("ratio", "count / trials", "0 to 1"),
    ),
    "exclusions.csv": (
        LABEL,
        PARTICIPANT,
        ("task", "id of the task; all: every one", "text"),
        ("trial", "trial left out; NA: the whole participant", "whole number"),
        ("attempt", "attempt left out; NA: the whole participant", "whole number"),
        ("rule", "rule of the protocol, or what happened", "text"),
        ("reason", "in words; an apostrophe leads what a spreadsheet would compute", "text"),
    ),
    "psychopy.csv": (
        LABEL,
        PARTICIPANT,
        ("session", "id of the task", "text"),
        ("trials.thisN", "place of the trial in its order, from 0", "whole number"),
        PRESENTED,
        ("corrAns", "the right answer: the material presented", "text"),
        ("key_resp.keys", "material named; None: none was named", "text"),
        ("key_resp.corr", "1: right", "0 or 1"),
        ("key_resp.rt", "contact of the foot to the confirmed answer; imported: as measured elsewhere", "seconds"),
        ("expName", "id of the study", "text"),
    ),
}
"""File -> its columns: name, what it holds, unit or kind."""

FIRST, SECOND = ("first", "material presented first", "text"), ("second", "material presented second", "text")

COMPARED: Mapping[str, tuple[tuple[str, str, str], ...]] = {
    "trials.csv": (
        *ATTEMPT,
        FIRST,
        SECOND,
        ("answered", f"which was named: first, second, or tie; {NO_ANSWER}: none was named", "text"),
        ("right", "1: the later of the study's materials was named; NA: one material twice, or no answer", "0 or 1"),
        ("response_time_s", "both samples laid out to the choice of the answer", "seconds"),
    ),
    "pairs.csv": (
        *WHOSE,
        FIRST,
        SECOND,
        ("first_named", "included trials in which the first was named", "whole number"),
        ("second_named", "included trials in which the second was named", "whole number"),
        ("ties", "included trials in which neither was named", "whole number"),
    ),
    "exclusions.csv": COLUMNS["exclusions.csv"],
}
"""The same of comparisons; `pairs.csv` holds what BradleyTerry2 asks for."""

DICTIONARY = "data_dictionary.csv"


def export(datasets: Sequence[Path], out: Path) -> tuple[Path, ...]:
    """Write every table of the datasets, pooled if there are several, into the folder `out`, and return the files.

    Raises `DatasetError` for a dataset that cannot be read or pooled, a folder within a dataset, or a file in the way.
    """
    check(out, (), "export")
    study = read_pooled(datasets)
    return publish(out, files(study), study.label, "export")


def files(study: Study) -> dict[str, bytes]:
    """Return every file by name; the dictionary describes every column of the others."""
    if study.answers is not None:
        compared = {"trials.csv": _compared(study), "pairs.csv": _pairs(study), "exclusions.csv": _exclusions(study)}
        return _written(study, compared, COMPARED)
    wide, wide_columns = _wide(study)
    frames = {
        "trials.csv": _trials(study),
        "long.csv": _long(study),
        "wide.csv": wide,
        "exclusions.csv": _exclusions(study),
        "psychopy.csv": _psychopy(study),
    }
    return _written(study, frames, {**COLUMNS, "wide.csv": wide_columns})


def _written(
    study: Study, frames: Mapping[str, pd.DataFrame], described: Mapping[str, tuple[tuple[str, str, str], ...]]
) -> dict[str, bytes]:
    dictionary = pd.DataFrame(
        [(name, *column) for name, columns in described.items() for column in columns],
        columns=["file", "column", "description", "unit"],
    )
    written = {}
    for name, frame in {**frames, DICTIONARY: dictionary}.items():
        frame.insert(0, LABEL[0], study.label or "measured")
        if name in described:
            frame["participant"] = frame["participant"].map("sub-{}".format, na_action="ignore")
            frame = frame[[column for column, _, _ in described[name]]]
        texts = frame.select_dtypes(include=["object", "string"]).columns
        frame[texts] = frame[texts].map(cell, na_action="ignore")
        missing = "" if name == "psychopy.csv" else "NA"
        written[name] = frame.to_csv(index=False, na_rep=missing, lineterminator="\n").encode()
    return written


def _compared(study: Study) -> pd.DataFrame:
    frame = study.attempts.copy()
    frame["answered"] = frame["answered"].where(frame["answered"] != MISSING)
    place = {material: index for index, material in enumerate(study.materials)}
    ahead = frame["first"].map(place) - frame["second"].map(place)
    wanted = pd.Series(np.where(ahead > 0, tapping.FIRST, tapping.SECOND), index=frame.index)
    judged = frame["answered"].isin(study.answers or ()) & (ahead != 0)
    frame["right"] = (frame["answered"] == wanted).astype("Int64").where(judged)
    return frame.assign(counted=frame["counted"].astype(int), included=frame["included"].astype(int))


def _pairs(study: Study) -> pd.DataFrame:
    names = {"first_named": tapping.FIRST, "second_named": tapping.SECOND, "ties": tapping.TIE}
    keys = ["participant", "task", "first", "second"]
    included = study.attempts[study.attempts["included"]]
    counted = included.assign(**{name: (included["answered"] == said).astype(int) for name, said in names.items()})
    return counted.groupby(keys, sort=False)[list(names)].sum().reset_index()


def _trials(study: Study) -> pd.DataFrame:
    frame = study.attempts.copy()
    frame["answered"] = frame["answered"].where(frame["answered"] != MISSING)
    right = (frame["presented"] == frame["answered"]).astype("Int64")
    frame["correct"] = right.where(frame["answered"].notna())
    frame["first_task"] = [study.first_tasks.get(who) for who in frame["participant"]]
    frame["frames_lost"] = frame["frames_lost"].astype("Int64")
    return frame.assign(counted=frame["counted"].astype(int), included=frame["included"].astype(int))


def _long(study: Study) -> pd.DataFrame:
    rows = [
        (who, task.id, presented, answered or NO_ANSWER, count, total, count / total if total else None)
        for task in study.tasks
        for who, presented, answered, count, total in confusion_of(study, task.id).cells()
    ]
    return pd.DataFrame(rows, columns=[name for name, _, _ in COLUMNS["long.csv"][1:]])


def _wide(study: Study) -> tuple[pd.DataFrame, tuple[tuple[str, str, str], ...]]:
    """Return one row for each participant: the correct ratio of every task and material, and which task was first."""
    long = _long(study)
    right = long[long["presented"] == long["answered"]]
    ratios = right.set_index(["participant", "task", "presented"])["ratio"].to_dict()
    people = list(dict.fromkeys(long["participant"]))
    described = [LABEL, PARTICIPANT, ("first_task", "the task that the participant did first", "text")]
    columns: dict[str, list[object]] = {
        "participant": list(people),
        "first_task": [study.first_tasks.get(who) for who in people],
    }
    for task in study.tasks:
        for material in study.materials:
            name = _name(f"{task.id}_{material}", columns)
            columns[name] = [ratios.get((who, task.id, material)) for who in people]
            described.append((name, f"correct answers to {material} in task {task.id} / its trials", "0 to 1"))
    return pd.DataFrame(columns), tuple(described)


def _name(text: str, taken: Mapping[str, object]) -> str:
    """Return a name that R, JASP and Python accept, and that no other column has."""
    name = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_") or "column"
    return name if name not in taken else f"{name}_{len(taken)}"


def _exclusions(study: Study) -> pd.DataFrame:
    rows: list[tuple[object, ...]] = [
        (one.participant, one.task, one.trial, one.attempt, one.rule, one.reason) for one in study.exclusions
    ]
    # A table without a row could not say what the dataset is.
    rows = rows or [(None, None, None, None, None, "nothing was left out")]
    frame = pd.DataFrame(rows, columns=[name for name, _, _ in COLUMNS["exclusions.csv"][1:]])
    return frame.astype({"trial": "Int64", "attempt": "Int64"})


def _psychopy(study: Study) -> pd.DataFrame:
    trials = study.attempts[study.attempts["included"]]
    return pd.DataFrame(
        {
            "participant": trials["participant"],
            "session": trials["task"],
            "trials.thisN": trials["trial"] - 1,
            "presented": trials["presented"],
            "corrAns": trials["presented"],
            "key_resp.keys": trials["answered"].replace(NO_ANSWER, "None"),
            "key_resp.corr": (trials["presented"] == trials["answered"]).astype(int),
            "key_resp.rt": trials["response_time_s"],
            "expName": study.id,
        }
    )
