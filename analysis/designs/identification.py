"""Identification: a trial presents one material, and asks which of them it was.

A study whose answers are materials comes in; its results, their sections and figures, and its exported tables go out.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from palpate.analysis.designs import AnalysisDesign, Described
from palpate.analysis.documents.tables import Section
from palpate.analysis.identification import results
from palpate.analysis.identification.confusion import confusion_of
from palpate.analysis.identification.results import Results, TaskResult
from palpate.analysis.identification.time_course import TimeCourse
from palpate.analysis.published.numbers import Published
from palpate.analysis.reading.dataset import Say
from palpate.analysis.reading.dissimilarities import NO_DISSIMILARITIES, from_file, printed_dissimilarities
from palpate.analysis.reading.study import Study
from palpate.analysis.report import sections
from palpate.analysis.statistics.anova import Anova
from palpate.experiment.records.events import NO_ANSWER


def _compute(study: Study, printed: Published | None, dissimilarities: Path | None, say: Say) -> Results:
    if dissimilarities is not None:
        alike = from_file(dissimilarities, study.materials)
    else:
        alike = printed_dissimilarities() if printed else NO_DISSIMILARITIES
    return results.compute(study, printed.pairs() if printed else {}, alike, say=say)


def _numbers(found: Results) -> dict[str, Any]:
    return {
        "tasks": [_task(task) for task in found.tasks], "identification": found.identifications,
        "one_way": [{**asdict(pair), "anova": _anova(pair.anova)} for pair in found.pairs],
        "two_way": [_anova(anova) for anova in found.two_way], "two_way_statement": found.two_way_statement,
        "beside": found.beside, "equivalence": found.equivalences,
        "planned": [{**asdict(one), "plan": one.plan.model_dump(mode="json")} for one in found.planned],
        "marginal": {"found": found.marginal[0], "statement": found.marginal[1]},
        "trials": found.trials, "course": _course(found.course), "icc": found.reliabilities,
        "variance_components": found.components,
    }  # fmt: skip


def _task(task: TaskResult) -> dict[str, Any]:
    matrix = task.confusion
    count = len(matrix.materials)
    return {
        **asdict(task.task),
        "chance": task.chance,
        "participants": matrix.participants,
        "counts": matrix.counts,
        "mean": [[matrix.mean(i, j) for j in range(count + 1)] for i in range(count)],
        "sd": [[matrix.sd(i, j) for j in range(count + 1)] for i in range(count)],
        "tests": [
            {"material": test.material, **asdict(test.result), "stars": task.stars(test), "p_holm": test.p_holm,
             "sign_flip": test.flip, "sign_flip_p_holm": test.flip_holm, "d_interval": test.d,
             "log_bf10": test.log_bf10, "interval": test.interval}
            for test in task.tests
        ],
    }  # fmt: skip


def _anova(anova: Anova | None) -> dict[str, Any] | None:
    if anova is None:
        return None
    sizes = {effect.name: anova.eta_squared(effect) for effect in anova.effects}
    return {**asdict(anova), "partial_eta_squared": sizes}


def _course(found: TimeCourse) -> dict[str, Any]:
    statements = [{"task": task, "of": of, "statement": why} for (task, of), why in found.statements.items()]
    return {**vars(found), "statements": statements}


def _counts(found: Results) -> tuple[Section, ...]:
    keys = ("task", "participant", "presented", "answered", "count", "trials")
    records = tuple(
        dict(zip(keys, (task.task.id, f"sub-{who}", presented, answered or NO_ANSWER, count, total), strict=True))
        for task in found.tasks
        for who, presented, answered, count, total in task.confusion.cells()
    )
    return (Section("counts", "Counts", further=records),)


def _export(study: Study, frame: pd.DataFrame, exclusions: pd.DataFrame) -> tuple[dict[str, pd.DataFrame], Described]:
    wide, ratios = _wide(study)
    frames = {
        "trials.csv": _trials(study, frame),
        "long.csv": _long(study),
        "wide.csv": wide,
        "exclusions.csv": exclusions,
        "psychopy.csv": _psychopy(study),
    }
    return frames, {"wide.csv": ratios}


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


def _psychopy(study: Study) -> pd.DataFrame:
    trials = study.attempts[study.attempts["included"]]
    columns = {
        "participant": trials["participant"], "session": trials["task"], "trials.thisN": trials["trial"] - 1,
        "presented": trials["presented"], "corrAns": trials["presented"],
        "key_resp.keys": trials["answered"].replace(NO_ANSWER, "None"),
        "key_resp.corr": (trials["presented"] == trials["answered"]).astype(int),
        "key_resp.rt": trials["response_time_s"], "expName": study.id,
    }  # fmt: skip
    return pd.DataFrame(columns)


DESIGN = AnalysisDesign(
    name="identification",
    trials="identifications",
    function="identify",
    compute=_compute,
    sections=sections.sections,
    numbers=_numbers,
    further=_counts,
    methods=sections.methods,
    export=_export,
    figures="palpate.analysis.report.figures",
    power="palpate.analysis.power.choice_models",
    audit="palpate.analysis.audit.audit",
)
