"""Single trials that a laboratory measured with other software -> a BIDS dataset, labeled as imported.

The answers are real, linked across tasks and in order, but no journal stands behind them. The files are not copied, for
they may hold names: the dataset has their SHA-256 and the line of each trial.
"""

import csv
import hashlib
import io
import re
import textwrap
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.dataset import bids
from palpate.experiment.dataset.imports import people
from palpate.experiment.dataset.imports.layout import ANY, Layout
from palpate.experiment.dataset.imports.reconstruction import STUDIES, check_study_id, check_texts, new_dataset
from palpate.experiment.dataset.imports.trial_files import Row, Trials, read_trials
from palpate.experiment.errors import DatasetError, Finding
from palpate.experiment.protocol.designs.comparison import FIRST, NAMED, SECOND, TIE
from palpate.experiment.records import software
from palpate.experiment.records.events import NO_ANSWER
from palpate.experiment.settings.characters import quoted
from palpate.experiment.settings.delimited import NOTHING_STATED, Stated, Understood

TASK = "identification"
"""Id of the task where no column tells tasks apart."""

KEPT = ("participant", "task", "trial", "file", "line", "presented", "answered", "response_time_s")
OF_PAIRS = (*KEPT[:5], "first", "second", *KEPT[6:])
"""Columns of the table of what was read, under sourcedata, and the same of comparisons."""


AT_A_TIME = 16
"""So many folders are written at a time."""

READ = 0.5
"""The share of the time in which files are read. Ours."""

SHOWN = 10
"""So many files are listed with how they were read."""


@dataclass(frozen=True)
class Imported:
    """A dataset that was made, how each file was read, and sentences for whoever knows what the files should hold.

    `doubts` are values that are not plausible.
    """

    root: Path
    sentences: tuple[str, ...]
    read_as: tuple[tuple[Path, Understood], ...]
    doubts: tuple[Finding, ...] = ()

    @property
    def files(self) -> tuple[str, ...]:
        """Return how each file was read, a line each; of many that were read alike, the first ones."""
        told = [f"{path}: {understood.sentence()}" for path, understood in self.read_as[:SHOWN]]
        more = len(self.read_as) - SHOWN
        return (*told, f"and {more} more files; --json shows how each was read") if more > 0 else tuple(told)

    def as_dict(self) -> dict[str, object]:
        """Return it for JSON."""
        read_as = [{"file": str(path), **understood.as_dict()} for path, understood in self.read_as]
        doubts = [doubt.sentence() for doubt in self.doubts]
        return {"dataset": str(self.root), "sentences": list(self.sentences), "doubts": doubts, "read_as": read_as}


def import_trials(
    paths: Sequence[Path],
    out: Path,
    layout: Layout,
    *,
    study: str,
    source: str,
    materials: Sequence[str] = (),
    stated: Stated = NOTHING_STATED,
    done: Callable[[float], None] = lambda _: None,
) -> Imported:
    """Build the dataset `out` from files of single trials; `done` is called with the share that is done.

    `study` is its id, `source` says where and how the answers were measured; `materials` are as in `read_trials`, by
    default a known paper's. Raises `DatasetError` as `read_trials`, and for a text that is not allowed, a file given
    twice, ambiguous participants or tasks, and an existing `out`.
    """
    check_study_id(study)
    check_texts(Path("--source"), {"source": source})
    if not materials and study in STUDIES:
        materials = tuple(STUDIES[study].materials)
    hashes = _hashes(paths)
    trials = read_trials(paths, layout, materials, stated, lambda share: done(READ * share))
    check_texts(paths[0], {"presented": trials.materials})
    tasks = _tasks(paths, layout, trials.rows)
    check_texts(paths[0], {"presented": tuple(tasks)} if layout.task else {})
    people.refuse_alike(paths, layout, trials, stated)
    labels, kept = people.labels(trials.rows)
    sessions = _sessions(trials.rows)
    said = _sentences(trials, labels, layout, kept=kept)
    several = _several_files(trials)
    counted = [f"CAUTION: {doubt.observation()}." for doubt in trials.doubts if doubt.check == "practice"]
    public = (*said, *_in_several([labels[who] for who in several]), *counted)
    with new_dataset(out) as root:
        text = _description(study, source, tuple(tasks.values()), public)
        files = bids.description(root, text)
        everyone = sorted(set(labels.values()), key=int)
        files |= bids.participants(root, ({"participant_id": f"sub-{label}"} for label in everyone), origin="IMPORTED")
        for (participant, task), rows in sessions.items():
            one = _task_text(tasks[task], task, source, trials, layout)
            files |= bids.events(root, labels[participant], one, map(_event, range(1, len(rows) + 1), rows))
        held = root / "sourcedata"
        files[held / f"{study}_trials.csv"] = _source_rows(sessions, labels, tasks, layout)
        files[held / "README"] = _sources(hashes, source, layout).encode()
        folders: dict[Path, bids.Files] = {}
        for path, content in files.items():
            folders.setdefault(path.parent, {})[path] = content
        # Each file waits for the disk, and there are two for each participant.
        with ThreadPoolExecutor(AT_A_TIME) as pool:
            for written, _ in enumerate(pool.map(bids.write_files, folders.values()), start=1):
                done(READ + (1 - READ) * written / len(folders))
    shown = [labels[who] if kept else f"{labels[who]} ({quoted(who)})" for who in several]
    return Imported(out, (*said, *_in_several(shown)), tuple(zip(paths, trials.read_as, strict=True)), trials.doubts)


def _hashes(paths: Sequence[Path]) -> tuple[str, ...]:
    found: dict[str, Path] = {}
    for path in paths:
        try:
            sha256 = hashlib.sha256(storage.read_bytes(path)).hexdigest()
        except OSError as error:
            raise DatasetError(
                path, f"cannot be read ({storage.why(error)})", "give a CSV file of trials in UTF-8"
            ) from error
        if (other := found.setdefault(sha256, path)) is not path:
            raise DatasetError(path, f"has the same content as {other}", "give each file once")
    return tuple(found)


def _tasks(paths: Sequence[Path], layout: Layout, rows: Sequence[Row]) -> dict[str, str]:
    """Return the id of each task by its name in the files, in the order of the files."""
    if layout.task is None:
        return {"": TASK if layout.second is None else "comparison"}
    found: dict[str, str] = {}
    for row in rows:
        if row.task in found:
            continue
        bare = re.sub(r"[^a-z0-9]", "", row.task.lower())
        label = bare if re.match(r"[a-z]", bare) else f"task{bare}"
        if label in found.values() or len(label) > 32 or not bare:
            raise DatasetError(
                paths[row.file - 1],
                f"got the task {row.task!r}, whose id would be {label!r}",
                "rename it",
                allowed="up to 32 letters and digits, unique to each task",
                field=f"column {layout.task}",
                line=row.line,
            )
        found[row.task] = label
    return found


def _sessions(rows: Sequence[Row]) -> dict[tuple[str, str], list[Row]]:
    """Return the trials of each participant and task, in their order."""
    found: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        found.setdefault((row.participant, row.task), []).append(row)
    return {key: sorted(rows, key=_position(rows)) for key, rows in found.items()}


def _position(rows: Sequence[Row]) -> Callable[[Row], tuple[int, int]]:
    """Return the key that sorts trials of one participant and task: sessions by number, or as they occur."""
    sessions = list(dict.fromkeys(row.session for row in rows))
    if all(re.fullmatch("[0-9]{1,9}", session) for session in sessions):
        sessions.sort(key=int)
    places = {session: place for place, session in enumerate(sessions)}
    return lambda row: (places[row.session], row.trial or 0)


def _event(trial: int, row: Row) -> dict[str, object]:
    return {
        "trial": trial,
        "attempt": 1,
        "counted": True,
        **({"presented": row.presented} if row.second is None else {"first": row.presented, "second": row.second}),
        "answered": row.answered,
        "response_time": row.response_time_s,
        "origin": "IMPORTED",
    }


def _order(layout: Layout) -> str:
    if layout.session is not None:
        within = "of the files and their lines" if layout.trial is None else f"of the column {layout.trial}"
        return (
            f"Sessions in the column {layout.session} are ordered by number, or otherwise by their order in the "
            "files. Trials are numbered from 1 across all sessions of a task; within each session, they are in the "
            f"order {within}."
        )
    if layout.trial is not None:
        return f"Trials are numbered from 1 in the order of the column {layout.trial}."
    return (
        "Trials are numbered from 1 in the order of the files and their lines, assumed to be the order of the session."
    )


def _sentences(trials: Trials, labels: dict[str, str], layout: Layout, *, kept: bool) -> tuple[str, ...]:
    silent = sum(row.answered == NO_ANSWER for row in trials.rows)
    words = {cell: trials.passed_over.count(cell) for cell in dict.fromkeys(trials.passed_over) if cell}
    of = "".join(f", {count} of them with '{cell}', which counts as a missing value" for cell, count in words.items())
    said = [
        f"Participants: {len(labels)}. Trials: {len(trials.rows)}, including {silent} without an answer. Materials: "
        f"{', '.join(trials.materials)}.",
        f"Rows skipped because they are not trials: {len(trials.passed_over)}{of}.",
        *_omissions(trials, layout),
        _order(layout),
    ]
    if layout.second is not None:
        said.append(
            "Materials are assumed to be listed in increasing order of the quality that was compared; --material "
            "changes the order."
        )
    if not kept:
        said.append(
            "Participants are numbered in the order of the files, because their labels are not all numbers of up to "
            "six digits with the same prefix (or no prefix)."
        )
    return tuple(said)


def _several_files(trials: Trials) -> list[str]:
    """Return the participants of whom several files have trials of one task and session."""
    files: dict[tuple[str, str, str], set[int]] = {}
    for row in trials.rows:
        files.setdefault((row.participant, row.task, row.session), set()).add(row.file)
    return list(dict.fromkeys(who for (who, _, _), several in files.items() if len(several) > 1))


def _in_several(named: Sequence[str]) -> list[str]:
    """Return the sentence of participants with several files, if there are any."""
    if not named:
        return []
    several = ", ".join(sorted(named))
    return [
        f"Several files contain trials from the same task for: {several}. If a run was restarted, leave out one of "
        "the two files."
    ]


def _omissions(trials: Trials, layout: Layout) -> list[str]:
    """Return what rules have left out, a sentence each."""
    told = [
        f"Rows left out, as requested: {trials.left_out.get((column, value), 0)} "
        + (
            "exported twice."
            if column == ANY
            else f"with {column} " + ("not empty." if value == ANY else f"= '{value}'.")
        )
        for column, value in layout.leave_out
    ]
    if layout.missing_times:
        rules = " or ".join(layout.missing_times)
        told.append(f"Response times that are {rules} count as missing, as requested: {trials.missing_times}.")
    return told


def _task_text(task: str, title: str, source: str, trials: Trials, layout: Layout) -> bids.TaskText:
    answers = {row.answered for row in trials.rows} & {TIE} | {FIRST, SECOND} if layout.second is not None else set()
    design = "identification" if layout.second is None else "comparison"
    return bids.TaskText(
        id=task,
        title=title or design.capitalize(),
        description=f"Measured elsewhere: {source}. {_order(layout)}",
        instructions="As in the source.",
        materials={material: material for material in trials.materials},
        stimulus_presentation={"SoftwareName": "not palpate; see the source"},
        origin="IMPORTED",
        kind="footstep" if layout.second is None else "tapping",
        design=design,
        answers={answer: text for answer, text in NAMED.items() if answer in answers},
    )


def _description(study: str, source: str, tasks: tuple[str, ...], said: Sequence[str]) -> bids.DatasetText:
    paragraphs = (
        f"These are answers by real participants, measured elsewhere by a laboratory: {source}. palpate "
        "read them from tables. It has no record of the sessions and cannot vouch for any answer.",
        *said,
        "The tables themselves are not included, because they may identify participants. sourcedata/ contains what "
        "was read from them, the line number of each trial and the SHA-256 of each file.",
        f"Trials without an answer have the answer {NO_ANSWER}. BIDS requires a column `onset` in seconds; n/a there "
        "means that the onset is not known.",
    )
    return bids.DatasetText(
        study=study,
        name=f"Answers of {study}",
        origin="IMPORTED",
        license="n/a: ask the laboratory",
        authors=(f"The laboratory that measured {study}",),
        tasks=tasks,
        references=(source,),
        software=software.this(),
        readme="\n\n".join(textwrap.fill(paragraph, 100) for paragraph in paragraphs),
    )


def _source_rows(
    sessions: dict[tuple[str, str], list[Row]], labels: dict[str, str], tasks: dict[str, str], layout: Layout
) -> bytes:
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(KEPT if layout.second is None else OF_PAIRS)
    for (participant, task), rows in sessions.items():
        for row in rows:
            time_s = "" if row.response_time_s is None else repr(row.response_time_s)
            number = "" if row.trial is None else row.trial
            place = (labels[participant], tasks[task], number, row.file, row.line)
            shown = (row.presented,) if row.second is None else (row.presented, row.second)
            writer.writerow((*place, *shown, row.answered, time_s))
    return file.getvalue().encode()


def _sources(hashes: Sequence[str], source: str, layout: Layout) -> str:
    columns = KEPT if layout.second is None else OF_PAIRS
    text = (
        f"Columns: {', '.join(columns)}. Each row is one imported trial, with its file and line. The trial number is "
        f"from the file; in JSON, the line is the number of the element. Source of the files: {source}."
    )
    files = "\n".join(f"file {number}: SHA-256 {sha256}" for number, sha256 in enumerate(hashes, start=1))
    return f"{bids.LABELS['IMPORTED']}\n\n{textwrap.fill(text, 100)}\n\n{files}\n"
