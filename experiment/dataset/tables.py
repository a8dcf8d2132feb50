"""Whether the tables on disk are those that the journals give."""

import json
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import zip_longest
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.dataset import bids, build
from palpate.experiment.dataset.checks import OPEN, Dataset, build_again, has_journals, load_sound, origin_of
from palpate.experiment.errors import DatasetError, PalpateError
from palpate.experiment.records import entries, journal
from palpate.experiment.records.progress import progress

READ = {
    "dataset_description.json": ("Name", "Palpate"),
    "_events.json": ("TaskTitle", "Instructions", "Materials", "Answers", "Rows", "SessionId"),
}
"""What analysis reads of JSON files, by the end of their names; each version words the rest in its own way."""

UNMADE = "a rehearsal makes its tables at its end, and not all are there yet; the same palpate rehearse goes on with it"


def unmade(root: Path, dataset: Dataset) -> bool:
    """Return whether a rehearsal without `derivatives` was interrupted, so that its tables may be missing or old."""
    if dataset.purpose != "REHEARSAL":
        return False
    complete = sum(progress(journal.read(path).entries).complete for path, _ in dataset.sessions)
    made = (root / "derivatives").exists() or all(_has_table(root, header) for _, header in dataset.sessions)
    return complete < sum(map(len, dataset.tasks.values())) or not made


def check_tables(root: Path) -> Dataset:
    """Return a dataset if journals, tables and raw frames agree, apart from open sessions.

    Raises as `load_sound`, and `DatasetError` for the first difference, or if no session ended and none has a table.
    """
    dataset = load_sound(root)
    doubts = edited(root, dataset, dataset.under_way)
    none = dataset.under_way and not any(_has_table(root, header) for _, header in dataset.sessions)
    if (doubts or none) and unmade(root, dataset):
        raise DatasetError(root, UNMADE)
    for doubt in doubts:
        raise doubt
    if none:
        raise DatasetError(
            root,
            "no session has ended yet, and no table has been made",
            build_again(root, "end one, or have tables made of what was answered so far", suffices=False),
        )
    return dataset


def check_analysed(root: Path) -> tuple[str, ...]:
    """Return what has to be said of a dataset before it is analysed: open sessions, or tables without a journal.

    Raises as `check_tables` where there are journals.
    """
    if has_journals(root):
        return tuple(f"{path}: {OPEN}" for path in sorted(check_tables(root).under_way))
    if (root / "dataset_description.json").exists() and origin_of(root) not in ("RECONSTRUCTION", "IMPORTED"):
        return (f"{root}: no journal stands behind these tables, so a changed cell would not show",)
    return ()


def edited(root: Path, dataset: Dataset, under_way: Collection[Path] = (), *, whole: bool = True) -> list[PalpateError]:
    """Return an error for each table that the journals do not give, and for frames that they do not name.

    Journals `under_way` may have tables since their last footer. Files of all participants are compared in a `whole`
    dataset.
    """
    doubts: list[PalpateError] = []

    def unlike(files: bids.Files) -> list[PalpateError]:
        found: list[PalpateError] = []
        for path, content in files.items():
            with _collected(found):
                _check_table(root, path, content)
        return found

    found = unlike(build.study_files(root, dataset)) if whole else []
    if found and under_way:
        told = [(path, of) for path, of in dataset.sessions if path not in under_way or _has_table(root, of)]
        files = build.study_files(root, replace(dataset, sessions=tuple(told)))
        # Before the first session ends nothing is made that could be missed.
        found = unlike({path: content for path, content in files.items() if told or path.exists()})
    doubts += found
    for path, header in dataset.sessions:
        made, contents = partial(build.session_table, root, dataset.protocol, dataset.purpose, path), journal.read(path)
        found = unlike(made(contents))
        if found and path in under_way:
            earlier = (unlike(made(then)) for then in _since_footer(contents))
            unmade = not until_footer(contents).lines and not _has_table(root, header)
            found = [] if unmade else min([found, *earlier], key=len)
        doubts += found
        with _collected(doubts):
            kind = build.kind_of(dataset.protocol.task(header.task))
            build.raw_frames(path, [outcome for outcome, _ in kind.cells(path, contents)])
    return doubts


@contextmanager
def _collected(doubts: list[PalpateError]) -> Iterator[None]:
    """Add the error that ends the block to `doubts`, and go on after it."""
    try:
        yield
    except PalpateError as doubt:
        doubts.append(doubt)


def _since_footer(contents: journal.Contents) -> Iterator[journal.Contents]:
    """Yield a journal as it was after each line since its last footer, the latest first, and at that footer."""
    lines, ended = contents.lines, len(until_footer(contents).lines)
    for count in range(len(lines) - 1, max(ended, 1) - 1, -1):
        yield replace(contents, lines=lines[:count])


def until_footer(contents: journal.Contents) -> journal.Contents:
    """Return a journal as it was when its session last ended, which is when its tables were made; empty if never."""
    ends = [number for number, entry in enumerate(contents.entries, start=1) if isinstance(entry, entries.Footer)]
    return replace(contents, lines=contents.lines[: ends[-1]] if ends else ())


def _has_table(root: Path, header: entries.Header) -> bool:
    return bids.beh_path(root, header.participant, header.task, "events.tsv").exists()


def _check_table(root: Path, path: Path, content: bytes) -> None:
    """Refuse a table that is not the one that the journals give."""
    # A journal that was cut, its head too, leaves nothing else behind that knows of what is gone.
    cause = "it was edited, or the journals are newer, or were changed themselves"
    remedy = build_again(root, f"{cause}; compare both with a backup, then make the tables again", suffices=False)
    if not path.exists():
        raise DatasetError(path, "is missing", build_again(root, "make it again"))
    read = next((keys for end, keys in READ.items() if path.name.endswith(end)), None)
    if read is None and path.suffix != ".tsv":
        return
    try:
        found = storage.read_bytes(path)
        if read is not None:
            on_disk, given = storage.json_of(found), json.loads(content)
            if not isinstance(on_disk, dict):
                raise ValueError("no JSON object")
            if differing := [key for key in read if on_disk.get(key) != given.get(key)]:
                raise DatasetError(path, f"{differing[0]} is not what the journals give: {remedy}")
            return
    except (OSError, ValueError) as error:
        raise DatasetError(path, f"cannot be read ({storage.why(error)}): {remedy}") from error
    lines = zip_longest(found.split(b"\n"), content.split(b"\n"))
    for number, (on_disk, given) in enumerate(lines, start=1):
        if on_disk != given:
            raise DatasetError(path, f"line {number} is not what the journal gives: {remedy}")
