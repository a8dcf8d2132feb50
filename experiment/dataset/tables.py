"""Whether the tables and traces on disk are those that the journals give."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from importlib import import_module
from itertools import zip_longest
from pathlib import Path
from typing import get_args

from palpate.experiment import storage
from palpate.experiment.dataset import bids, build
from palpate.experiment.dataset.checks import (
    OF_TABLES,
    OPEN,
    Dataset,
    build_again,
    findings,
    has_journals,
    load_sound,
)
from palpate.experiment.dataset.outside import losses
from palpate.experiment.errors import DatasetError, Finding, PalpateError
from palpate.experiment.records import entries, journal
from palpate.experiment.records.progress import progress
from palpate.experiment.study.lines import IncidentKind
from palpate.experiment.study.roster import Roster


def origin_of(root: Path) -> str:
    """Return what the tables of a dataset say that they are. Raises `DatasetError` if they say nothing."""
    try:
        return str(storage.json_of(storage.read_bytes(root / "dataset_description.json"))["Palpate"]["Origin"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DatasetError(root, "is not a palpate dataset", "give the folder that contains sourcedata") from error


READ = {
    "dataset_description.json": ("Name", "Palpate"),
    "_events.json": ("TaskTitle", "Instructions", "Kind", "Design", "Materials", "Answers", "Rows", "SessionId"),
}
"""What analysis reads of JSON files, by the end of their names; each version words the rest in its own way."""

OF_INCIDENTS = (*get_args(IncidentKind), "informed")
"""Kinds of lines of a roster that tell of an adverse event or a deviation."""

ALONE = {"RECONSTRUCTION": "only counts from a publication", "IMPORTED": "only imported answers"}
"""What stands behind tables that never had a journal, by their origin."""

UNMADE = "a rehearsal makes its tables at the end, and some are missing; run the same palpate rehearse to continue it"


def unmade(root: Path, dataset: Dataset) -> bool:
    """Return whether a rehearsal without `derivatives` was interrupted, so that its tables may be missing or old."""
    if dataset.purpose != "REHEARSAL":
        return False
    complete = sum(progress(journal.read(path).entries).complete for path, _ in dataset.sessions)
    made = (root / "derivatives").exists() or all(_has_table(root, header) for _, header in dataset.sessions)
    return complete < sum(map(len, dataset.tasks.values())) or not made


def check_tables(root: Path) -> Dataset:
    """Return a dataset if journals, tables, traces and raw frames agree, apart from open sessions.

    Raises as `load_sound`, and `DatasetError` for the first difference, or if no session ended and none has a table.
    """
    dataset = load_sound(root)
    doubts = list(findings(dataset, *OF_TABLES))
    none = dataset.under_way and not any(_has_table(root, header) for _, header in dataset.sessions)
    if (doubts or none) and unmade(root, dataset):
        raise DatasetError(root, UNMADE)
    for doubt in doubts:
        raise DatasetError.at(doubt)
    if none:
        raise DatasetError(
            root,
            "no session has ended yet, so there are no tables",
            build_again(root, "end a session, or make tables from the answers recorded so far", suffices=False),
        )
    return dataset


def check_analysed(root: Path) -> tuple[str, ...]:
    """Return what has to be said of a dataset before it is analysed: open sessions, or tables without a journal.

    Raises as `check_tables` where there are journals.
    """
    if has_journals(root):
        return tuple(f"{path}: {OPEN}" for path in sorted(check_tables(root).under_way))
    if storage.shared_path(root).exists():
        for finding in import_module("palpate.experiment.dataset.outside.shared").findings(root):
            if finding.refuses:
                raise DatasetError.at(finding)
        return ()
    if (root / "dataset_description.json").exists() and origin_of(root) not in ("RECONSTRUCTION", "IMPORTED"):
        return (f"{root}: these tables have no journals, so palpate cannot detect a changed cell",)
    return ()


def differences(dataset: Dataset) -> Iterator[Finding]:
    """Yield each table that the journals do not give.

    Journals under way may have tables since their last footer. Files of all participants are compared in a whole
    dataset.
    """
    root = dataset.root
    yield from _of_study(dataset) if dataset.whole else ()
    for path, header in dataset.sessions:
        contents = journal.read(path)
        made = partial(build.session_table, root, dataset.version(header), dataset.purpose, path)
        unlike = _differing(root, made(contents))
        if unlike and path in dataset.under_way:
            earlier = (_differing(root, made(then)) for then in _since_footer(contents))
            unmade = not until_footer(contents).lines and not _has_table(root, header)
            unlike = [] if unmade else min([unlike, *earlier], key=len)
        older = unlike and any(not _differing(root, made(then)) for then in _at_footers(contents))
        yield from _older(root, unlike) if older else unlike


def lost_traces(dataset: Dataset) -> Iterator[Finding]:
    """Yield raw frames that are not those a journal names, and each trace of a foot or a force that is missing."""
    for path, header in dataset.sessions:
        contents = journal.read(path)
        try:
            for _ in build.raw_frames(path, losses.without_lost(path, contents.entries)):
                pass
        except PalpateError as error:
            yield error.finding
        ended = until_footer(contents) if path in dataset.under_way else contents
        there = losses.without_lost(path, ended.entries)
        counted = [one for one in there if not isinstance(one, entries.Trained)]
        whole = [one for one in counted if not isinstance(one, entries.Outcome) or one.asks]
        names = {trace.recording for one in whole if (trace := one.frames)}
        for end in (f"recording-{name}_physio.{suffix}" for name in sorted(names) for suffix in ("tsv.gz", "json")):
            file = bids.beh_path(dataset.root, header.participant, header.task, end)
            if not file.exists():
                yield _missing(dataset.root, file)


def _of_study(dataset: Dataset) -> list[Finding]:
    """Return each file of all participants that the journals do not give, with or without those under way.

    The files of a session in which an incident was told have it once they are made again, as that ends.
    """
    unlike = _of_study_as_known(dataset)
    if unlike and any(not _of_study_as_known(replace(dataset, roster=then)) for then in _before(dataset.people)):
        what = "is older than the roster, which has newer adverse events or deviations"
        remedy = build_again(dataset.root, "make it again")
        return [] if dataset.under_way else [Finding(what, one.where, remedy=remedy) for one in unlike]
    return unlike


def _before(people: Roster) -> Iterator[Roster]:
    """Yield a roster as it was in what it says of incidents before each line about one, the latest first."""
    told = [n for n, link in enumerate(people.lines.links) if link.entry.get("kind") in OF_INCIDENTS]
    for number in reversed(told):
        earlier = people.as_of(people.lines.links[number - 1].sha256).incidents if number else []
        yield replace(people, incidents=earlier)


def _of_study_as_known(dataset: Dataset) -> list[Finding]:
    root, under_way = dataset.root, dataset.under_way
    unlike = _differing(root, build.study_files(root, dataset))
    if unlike and under_way:
        ended = tuple((path, of) for path, of in dataset.sessions if path not in under_way or _has_table(root, of))
        files = build.study_files(root, replace(dataset, sessions=ended))
        # Before the first session ends nothing is made that could be missed.
        unlike = _differing(root, {path: content for path, content in files.items() if ended or path.exists()})
    made = tuple((path, of) for path, of in dataset.sessions if _has_table(root, of))
    older = unlike and not _differing(root, build.study_files(root, replace(dataset, sessions=made)))
    return [*_older(root, unlike)] if older else unlike


def _differing(root: Path, files: bids.Files) -> list[Finding]:
    """Return what is wrong with each of these files that is not on disk as the journals give it."""
    return [finding for path, content in files.items() if (finding := _difference(root, path, content))]


def _since_footer(contents: journal.Contents) -> Iterator[journal.Contents]:
    """Yield a journal as it was after each line since its last footer, the latest first, and at that footer."""
    lines, ended = contents.lines, len(until_footer(contents).lines)
    for count in range(len(lines) - 1, max(ended, 1) - 1, -1):
        yield replace(contents, lines=lines[:count])


def _at_footers(contents: journal.Contents) -> Iterator[journal.Contents]:
    """Yield a journal as it was whenever its session ended, the latest first."""
    while (contents := until_footer(replace(contents, lines=contents.lines[:-1]))).lines:
        yield contents


def until_footer(contents: journal.Contents) -> journal.Contents:
    """Return a journal as it was when its session last ended, which is when its tables were made; empty if never."""
    ends = [number for number, entry in enumerate(contents.entries, start=1) if isinstance(entry, entries.Footer)]
    return replace(contents, lines=contents.lines[: ends[-1]] if ends else ())


def _has_table(root: Path, header: entries.Header) -> bool:
    return bids.beh_path(root, header.participant, header.task, "events.tsv").exists()


CAUSE = "it was edited, or the journals are newer or have changed"
"""A journal that was cut, its head too, leaves nothing else behind that knows of what is gone."""


def _difference(root: Path, path: Path, content: bytes) -> Finding | None:
    """Return what is wrong with a table that is not the one that the journals give."""
    if not path.exists():
        return _missing(root, path)
    keys = next((keys for end, keys in READ.items() if path.name.endswith(end)), None)
    if keys is None and path.suffix != ".tsv":
        return None
    remedy = build_again(
        root, "compare the table and the journal with a backup, then make the tables again", suffices=False
    )
    older = _format_of(root) != storage.DATASET_FORMAT
    what = _differing_line(path, content, older=older) if keys is None else _differing_key(path, content, keys)
    return Finding(f"{what}: {CAUSE}", path, remedy=remedy) if what else None


def _older(root: Path, unlike: Sequence[Finding]) -> Iterator[Finding]:
    """Yield what is wrong with tables that journals gave before their last lines, as a kill leaves them."""
    for one in unlike:
        yield Finding("matches an earlier state of the journals", one.where, remedy=build_again(root, "make it again"))


def _missing(root: Path, path: Path) -> Finding:
    return Finding("is missing", path, remedy=build_again(root, "make it again"))


def _format_of(root: Path) -> object:
    """Return the format that the tables of a dataset state, today's where they cannot be read."""
    try:
        return storage.json_of(storage.read_bytes(root / "dataset_description.json"))["Palpate"]["Format"]
    except (OSError, ValueError, KeyError, TypeError):
        return storage.DATASET_FORMAT


def _differing_line(path: Path, content: bytes, *, older: bool) -> str:
    """Return which line of a table is another than given, or that it cannot be read; empty if it is as given.

    A table of an `older` format may lack columns that came later.
    """
    try:
        on_disk = storage.read_bytes(path)
        given = _with_columns(content, on_disk.partition(b"\n")[0].split(b"\t")) if older else content
        lines = zip_longest(on_disk.split(b"\n"), given.split(b"\n"))
    except OSError as error:
        return f"cannot be read ({storage.why(error)})"
    different = (number for number, (on_disk, given) in enumerate(lines, start=1) if on_disk != given)
    return f"line {number} does not match the journal" if (number := next(different, 0)) else ""


def _with_columns(table: bytes, columns: Sequence[bytes]) -> bytes:
    """Return a table with some of its columns, in this order; whole where it lacks one of them."""
    header, *rows = (line.split(b"\t") for line in table.splitlines())
    if not {*columns} <= {*header}:
        return table
    places = [header.index(column) for column in columns]
    return b"".join(b"\t".join(row[place] for place in places) + b"\n" for row in (header, *rows))


def _differing_key(path: Path, content: bytes, keys: Sequence[str]) -> str:
    """Return which of these keys of a JSON file is another than given, or that it cannot be read; empty if none is."""
    try:
        on_disk, given = storage.json_of(storage.read_bytes(path)), json.loads(content)
    except (OSError, ValueError) as error:
        return f"cannot be read ({storage.why(error)})"
    if not isinstance(on_disk, dict):
        return "cannot be read (not a JSON object)"
    if isinstance(facts := on_disk.get("Palpate"), dict) and facts.get("Format") != storage.DATASET_FORMAT:
        # Facts of an older format are compared as far as it has them.
        given["Palpate"] = {**{key: given["Palpate"].get(key) for key in facts}, "Format": facts.get("Format")}
    different = (key for key in keys if on_disk.get(key) != given.get(key))
    return f"{key} does not match the journals" if (key := next(different, "")) else ""
