"""Study -> tables for other software, with a dictionary of every column.

`trials.csv` has a row for each attempt, `long.csv` counts for R, `wide.csv` a row for each participant for JASP,
`psychopy.csv` PsychoPy's columns; `pairs.csv` counts ordered pairs, `heard.csv` has what an accelerometer
heard. Attempts of controls are in `control.csv`, and not in `trials.csv` or counts. UTF-8 with commas; NA is missing,
or empty for PsychoPy.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from palpate.analysis import designs
from palpate.analysis.conditions.control import apart
from palpate.analysis.documents.output import check, publish
from palpate.analysis.documents.tables import cell
from palpate.analysis.reading.files import FURTHER, MISSING
from palpate.analysis.reading.pooled import read_pooled
from palpate.analysis.reading.study import Study
from palpate.experiment.records import events
from palpate.experiment.synthesis.noticing import THIRDS_HZ

DICTIONARY, HEARD, CONTROL = "data_dictionary.csv", "heard.csv", "control.csv"
OF_ATTEMPTS = ("dataset", "participant", "task", "trial", "attempt", "counted", "included")
PRESENTED = ("presented", "first", "second")
"""Columns that name a material of a trial."""

THIRDS = ("sent_thirds", "heard_thirds")


def columns_of(design: str) -> dict[str, dict[str, tuple[str, str]]]:
    """Return the columns of the files of a design, from its JSON file in `designs/`; `wide.csv` has one more a cell."""
    file = Path(__file__).with_name("designs") / f"{design}.json"
    known: dict[str, Any] = json.loads(file.read_text("utf-8"))
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
    design = designs.design_of(study)
    rest, controls = apart(study)
    own = frame["task"].isin({one.task for one in controls})
    frames, further = design.export(rest, frame[~own].copy(), _exclusions(study))
    columns = columns_of(design.name)
    if controls:
        every, _ = design.export(study, frame.copy(), _exclusions(study))
        frames = {**frames, CONTROL: every["trials.csv"][own].copy()}
        columns[CONTROL] = dict(columns["trials.csv"])
    heard = frame[frame["heard_thirds"].notna() & frame["sent_thirds"].notna()]
    if not heard.empty:
        levels = pd.concat([pd.DataFrame(heard[of].tolist(), heard.index, _thirds(of)) for of in THIRDS], axis=1)
        frames = {**frames, HEARD: heard.join(levels)}
        columns[HEARD] = {name: columns["trials.csv"][name] for name in OF_ATTEMPTS} | _of_heard()
    for name, described in further.items():
        columns[name] |= described
    for name in {"trials.csv", CONTROL} & frames.keys():
        columns[name] |= _with_factors(study, frames[name])
    return _written(study, frames, columns)


def _with_factors(study: Study, trials: pd.DataFrame) -> dict[str, tuple[str, str]]:
    """Add to a table of trials the site and each factor of each stimulus, and return what these columns are."""
    described: dict[str, tuple[str, str]] = {}
    factors = dict.fromkeys(name for values in study.factors.values() for name in values)
    sites = _sites(study)
    for place in (one for one in PRESENTED if one in trials):
        for name in factors if trials[place].isin(study.factors).any() else ():
            values = {material: of[name] for material, of in study.factors.items()}
            trials[f"{place}_{name}"] = trials[place].map(values)
            described[f"{place}_{name}"] = (f"factor {name} of the material in the column {place}", "number")
        if sites:
            trials[f"{place}_site"] = trials[place].map(sites)
            described[f"{place}_site"] = (f"site of the body of the material in the column {place}", "text")
    return described


def _sites(study: Study) -> dict[str, str | None]:
    """Return the site of the body of each material, if there are several; nothing where protocols differ in them."""
    known = [one.protocol for one in study.parts if one.protocol]
    each = [{**one.kind_table(task).site_of} for one in known for task in one.tasks]
    return each[0] if each and any(each[0].values()) and all(one == each[0] for one in each) else {}


def _of_heard() -> dict[str, tuple[str, str]]:
    """Return the columns of what an accelerometer heard, with descriptions and units: those of events tables."""
    named, units = {column: name for name, column in FURTHER.items()}, {"heard_of": "text", "heard_gain": "share"}
    told = {
        named.get(column, column): (str(text["Description"]), str(text.get("Units") or units[column]))
        for group in ("heard_of", "heard")
        for column, text in events.columns_of(group).items()
    }
    thirds = {of: told.pop(of) for of in THIRDS}
    return told | {name: text for of, text in thirds.items() for name in _thirds(of)}


def _thirds(of: str) -> list[str]:
    """Return the columns of the levels of third octaves, by their middle, Hz."""
    return [f"{of}_{hz:.3g}_hz" for hz in THIRDS_HZ]


def _written(study: Study, frames: Mapping[str, pd.DataFrame], described: designs.Described) -> dict[str, bytes]:
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


def _exclusions(study: Study) -> pd.DataFrame:
    rows: list[tuple[object, ...]] = [
        (one.participant, one.task, one.trial, one.attempt, one.rule, one.reason) for one in study.exclusions
    ]
    # A table without a row could not say what the dataset is.
    rows = rows or [(None, None, None, None, None, "nothing was left out")]
    frame = pd.DataFrame(rows, columns=["participant", "task", "trial", "attempt", "rule", "reason"])
    return frame.astype({"trial": "Int64", "attempt": "Int64"})
