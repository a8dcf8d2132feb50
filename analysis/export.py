"""Study -> tables for other software, with a dictionary of every column.

`trials.csv` has a row for each attempt, `long.csv` counts for R, `wide.csv` a row for each participant for JASP,
`psychopy.csv` PsychoPy's columns; `pairs.csv` counts ordered pairs. UTF-8 with commas; NA is missing, or empty for
PsychoPy.
"""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from palpate.analysis.documents.output import check, publish
from palpate.analysis.documents.tables import cell
from palpate.analysis.identification.confusion import confusion_of
from palpate.analysis.reading.dataset import MISSING, read_pooled
from palpate.analysis.reading.study import Study
from palpate.experiment.records.events import NO_ANSWER
from palpate.experiment.records.kinds import tapping

DICTIONARY = "data_dictionary.csv"

Columns = dict[str, dict[str, tuple[str, str]]]
"""File -> its columns: name -> what it holds, and its unit or kind."""


def columns_of(kind: Literal["identification", "comparison"]) -> Columns:
    """Return the columns of a kind of study's files, as in export_columns.json; `wide.csv` has one more a cell."""
    known: Columns = json.loads(Path(__file__).with_name("export_columns.json").read_text("utf-8"))[kind]
    return known


def export(datasets: Sequence[Path], out: Path) -> tuple[Path, ...]:
    """Write every table of the datasets, pooled if there are several, into the folder `out`, and return the files.

    Raises `DatasetError` for a dataset that cannot be read or pooled, a folder within a dataset, or a file in the way.
    """
    check(out, (), "export")
    study = read_pooled(datasets)
    return publish(out, files(study), study.label, "export")


def files(study: Study) -> dict[str, bytes]:
    """Return every file by name; the dictionary describes every column of the others."""
    frame = study.attempts.copy()
    frame = frame.assign(
        answered=frame["answered"].where(frame["answered"] != MISSING),
        counted=frame["counted"].astype(int),
        included=frame["included"].astype(int),
    )
    if study.answers is not None:
        compared = {
            "trials.csv": _compared(study, frame),
            "pairs.csv": _pairs(study),
            "exclusions.csv": _exclusions(study),
        }
        return _written(study, compared, columns_of("comparison"))
    columns = columns_of("identification")
    wide, ratios = _wide(study)
    columns["wide.csv"] |= ratios
    frames = {
        "trials.csv": _trials(study, frame),
        "long.csv": _long(study),
        "wide.csv": wide,
        "exclusions.csv": _exclusions(study),
        "psychopy.csv": _psychopy(study),
    }
    return _written(study, frames, columns)


def _written(study: Study, frames: Mapping[str, pd.DataFrame], described: Columns) -> dict[str, bytes]:
    dictionary = pd.DataFrame(
        [(name, column, *said) for name, columns in described.items() for column, said in columns.items()],
        columns=["file", "column", "description", "unit"],
    )
    written = {}
    for name, frame in {**frames, DICTIONARY: dictionary}.items():
        frame.insert(0, "dataset", study.label or "measured")
        if name in described:
            frame["participant"] = frame["participant"].map("sub-{}".format, na_action="ignore")
            frame = frame[list(described[name])]
        texts = frame.select_dtypes(include=["object", "string"]).columns
        frame[texts] = frame[texts].map(cell, na_action="ignore")
        missing = "" if name == "psychopy.csv" else "NA"
        written[name] = frame.to_csv(index=False, na_rep=missing, lineterminator="\n").encode()
    return written


def _compared(study: Study, frame: pd.DataFrame) -> pd.DataFrame:
    place = {material: index for index, material in enumerate(study.materials)}
    ahead = frame["first"].map(place) - frame["second"].map(place)
    wanted = pd.Series(np.where(ahead > 0, tapping.FIRST, tapping.SECOND), index=frame.index)
    judged = frame["answered"].isin(study.answers or ()) & (ahead != 0)
    frame["right"] = (frame["answered"] == wanted).astype("Int64").where(judged)
    return frame


def _pairs(study: Study) -> pd.DataFrame:
    names = {"first_named": tapping.FIRST, "second_named": tapping.SECOND, "ties": tapping.TIE}
    keys = ["participant", "task", "first", "second"]
    included = study.attempts[study.attempts["included"]]
    counted = included.assign(**{name: (included["answered"] == said).astype(int) for name, said in names.items()})
    return counted.groupby(keys, sort=False)[list(names)].sum().reset_index()


def _trials(study: Study, frame: pd.DataFrame) -> pd.DataFrame:
    right = (frame["presented"] == frame["answered"]).astype("Int64")
    frame["correct"] = right.where(frame["answered"].notna())
    frame["first_task"] = [study.first_tasks.get(who) for who in frame["participant"]]
    frame["frames_lost"] = frame["frames_lost"].astype("Int64")
    return frame


def _long(study: Study) -> pd.DataFrame:
    rows = [
        (who, task.id, presented, answered or NO_ANSWER, count, total, count / total if total else None)
        for task in study.tasks
        for who, presented, answered, count, total in confusion_of(study, task.id).cells()
    ]
    names = ["participant", "task", "presented", "answered", "count", "trials", "ratio"]
    return pd.DataFrame(rows, columns=names)


def _wide(study: Study) -> tuple[pd.DataFrame, dict[str, tuple[str, str]]]:
    """Return one row for each participant, first task and the correct ratio of every task and material; and these."""
    long = _long(study)
    right = long[long["presented"] == long["answered"]]
    ratios = right.set_index(["participant", "task", "presented"])["ratio"].to_dict()
    people = list(dict.fromkeys(long["participant"]))
    described = {}
    columns: dict[str, list[object]] = {
        "participant": list(people),
        "first_task": [study.first_tasks.get(who) for who in people],
    }
    for task in study.tasks:
        for material in task.presented:
            name = _name(f"{task.id}_{material}", columns)
            columns[name] = [ratios.get((who, task.id, material)) for who in people]
            described[name] = (f"correct answers to {material} in task {task.id} / its trials", "0 to 1")
    return pd.DataFrame(columns), described


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
    frame = pd.DataFrame(rows, columns=["participant", "task", "trial", "attempt", "rule", "reason"])
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
