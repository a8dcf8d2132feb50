"""Counts per participant, presented and answered material -> a BIDS dataset, one row a trial.

Counts that a laboratory measured are labeled as imported. Others, integer counts that reproduce a publication's tables,
are labeled as a reconstruction throughout: it has no times, no order of trials and no link between tasks.
"""

import re
import textwrap
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.dataset import bids
from palpate.experiment.errors import DatasetError, PalpateError, ProtocolError
from palpate.experiment.records.events import NO_ANSWER
from palpate.experiment.records.software import Software, this
from palpate.experiment.settings.characters import quoted
from palpate.experiment.settings.delimited import NOTHING_STATED, Record, Stated, Table, Understood, read_table
from palpate.experiment.settings.load import MISSING, Confined, Name, Text, checked

COLUMNS = ("participant", "presented", "answered", "count")
"""Header of a counts file."""

MAX_COUNT = 10_000
"""A count above this is taken for a slip of the pen."""

Counts = Mapping[int, Mapping[tuple[str, str], int]]
"""participant number -> (presented, answered) -> count"""


@contextmanager
def new_dataset(out: Path) -> Iterator[Path]:
    """Yield a folder that becomes `out` if the block succeeds. Raises `DatasetError` unless `out` can be made anew."""
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise DatasetError(
            out,
            "already exists, and palpate never overwrites a dataset",
            "choose another, or move it away",
            allowed="a new or empty folder",
        )
    try:
        with storage.new_folder(out) as partial:
            yield partial
    except OSError as error:
        raise DatasetError(
            f"cannot make {out}: {error.strerror}", remedy="make the folder writable or choose another"
        ) from error


def parse_task(text: str) -> tuple[str, Path]:
    """Return task id and counts file of `TASK=FILE`. Raises `DatasetError` for any other text."""
    task, equals, file = text.partition("=")
    if not (equals and file and re.fullmatch(r"[a-z][a-z0-9]*", task)):
        raise DatasetError(
            f"got {text!r}", remedy="correct it", allowed="TASK=FILE, the task in lowercase letters and digits"
        )
    return task, Path(file)


def read_counts(path: Path, materials: Sequence[str], stated: Stated = NOTHING_STATED) -> Counts:
    """Return the counts in a table with the header of `COLUMNS`; answers are `materials` or `NO_ANSWER`.

    Participants are whole numbers, with or without zeros and `sub-`, each spelled in one way. Raises `DatasetError`
    with file and line otherwise.
    """
    counts: dict[int, dict[tuple[str, str], int]] = {}
    spelt: dict[int, str] = {}
    for row in _table(path, stated).rows:
        where = f"{path}: line {row.line}"
        participant, cell, count = _row([one.strip() for one in row.cells], where, materials)
        if (spelling := spelt.setdefault(participant, row.cells[0])) != row.cells[0]:
            raise DatasetError(
                where,
                f"participant: got {row.cells[0]!r} here and {spelling!r} above",
                "keep one",
                allowed="one spelling",
            )
        if cell in counts.setdefault(participant, {}):
            raise DatasetError(where, f"got participant {participant}, {cell} twice", "remove one of the lines")
        counts[participant][cell] = count
    if not counts:
        raise DatasetError(path, "got no counts below the header", "add them", allowed="one line per cell")
    return counts


def _table(path: Path, stated: Stated) -> Table:
    try:
        table = read_table(path, COLUMNS, (), stated)
    except PalpateError as error:
        raise DatasetError.saying(error) from error
    answers = table.header[2:]
    if table.header[:2] == COLUMNS[:2] and len(answers) > 1 and not {*answers} & {*COLUMNS, ""}:
        return replace(table, header=COLUMNS, rows=tuple(_cells_of_matrices(path, table)))
    if table.header != COLUMNS:
        remedy = "rename the columns, or, for a matrix, use participant,presented and one column per answer"
        raise DatasetError(path, f"line 1: got header {','.join(table.header)!r}", remedy, allowed=",".join(COLUMNS))
    return table


def _cells_of_matrices(path: Path, table: Table) -> Iterator[Record]:
    """Yield a record for each cell of matrices, whose rows are materials presented, and whose columns are answers."""
    for row in table.rows:
        if len(row.cells) != len(table.header):
            what, allowed = f"got {len(row.cells)} fields", f"{len(table.header)}, as in the header"
            raise DatasetError(path, what, "correct the line", allowed=allowed, line=row.line)
        for answered, count in zip(table.header[2:], row.cells[2:], strict=True):
            yield replace(row, cells=[*row.cells[:2], answered, count])


def read_as(path: Path, stated: Stated) -> Understood:
    """Return how a counts file is read."""
    return _table(path, stated).understood


def materials_of(path: Path, stated: Stated) -> tuple[str, ...]:
    """Return every material that a counts file presents, in its order. Raises `DatasetError` if it cannot be read."""
    at = COLUMNS.index("presented")
    cells = (row.cells[at].strip() for row in _table(path, stated).rows if len(row.cells) > at)
    found = tuple(dict.fromkeys(cell for cell in cells if cell))
    check_texts(path, {"presented": found})
    return found


class _Texts(Confined):
    """What of a study without texts here comes from whoever imports it."""

    presented: tuple[Name, ...] = ()
    source: Text = "none"


def check_texts(where: Path, texts: dict[str, object]) -> None:
    """Raise `DatasetError` if `presented` are no names, or `source` is no text, that a dataset may hold."""
    try:
        checked(where, _Texts, texts)
    except ProtocolError as error:
        raise DatasetError.at(
            replace(error.findings[0], remedy="rename the material, or give another source")
        ) from error
    presented = texts.get("presented")
    for name in presented if isinstance(presented, tuple) else ():
        if name in MISSING:
            raise DatasetError(where, f"got the material '{name}', which means a missing value in tables", "rename it")


def _row(row: list[str], where: str, materials: Sequence[str]) -> tuple[int, tuple[str, str], int]:
    if len(row) != len(COLUMNS):
        raise DatasetError(where, f"got {len(row)} fields", allowed=f"{len(COLUMNS)}, {','.join(COLUMNS)}")
    participant, presented, answered, count = row
    answers = (*materials, NO_ANSWER)
    if not re.fullmatch(r"(sub-)?0{0,5}[1-9][0-9]{0,5}", participant):
        raise DatasetError(
            where, f"got {participant!r}", field="participant", allowed="a whole number from 1 to 999999"
        )
    if presented not in materials:
        raise DatasetError(where, f"got {presented!r}", field="presented", allowed=", ".join(materials))
    if answered not in answers:
        raise DatasetError(where, f"got {answered!r}", field="answered", allowed=", ".join(answers))
    # Spreadsheets write whole numbers with decimals, but three of them may be a thousand.
    count = re.sub(r"[.,]0{1,2}\Z", "", count)
    if not re.fullmatch(r"[0-9]{1,5}", count) or int(count) > MAX_COUNT:
        raise DatasetError(where, f"got {count!r}", field="count", allowed=f"a whole number from 0 to {MAX_COUNT}")
    return int(participant.removeprefix("sub-")), (presented, answered), int(count)


NO_TIME = "Times are not known: onset, duration and response_time are n/a."
ORDER = "The trial order is not known: trials are numbered by the material presented, then by the answer."
UNKNOWN = (
    f"{NO_TIME} {ORDER} The grouping of rows into participants is arbitrary, as is the matching of participants "
    "across tasks."
)

KNOWN = {
    "RECONSTRUCTION": "Counts consistent with the tables in: {source}.",
    "IMPORTED": "Counts of answers, measured elsewhere: {source}.",
}
ABOUT = {
    "RECONSTRUCTION": "These are not original data. They are integer counts per participant, presented material and "
    "answer that agree with the tables printed in: {source}. Other counts may agree equally well. "
    "Draw no conclusions from them that the printed tables do not support.",
    "IMPORTED": "These are answers by real participants, measured elsewhere by a laboratory: {source}. "
    "palpate read how often each participant gave each answer. It has no record of the sessions and cannot vouch for "
    "any answer.",
}
FOUND = {
    "RECONSTRUCTION": "Found by a search for integer counts that reproduce the printed means, standard deviations and "
    "tests in: {source}.",
    "IMPORTED": "Counted by the laboratory that measured the answers: {source}.",
}
"""What a task, a dataset and its source say of counts, by their origin."""


@dataclass(frozen=True)
class StudyText:
    """What is known of a published study: enough to describe its dataset.

    `id` is its protocol's, `source` the publication; `materials` maps ids to descriptions, `tasks` to (title,
    instructions), in the order of the tables; `notes` are for readers. `origin` is `IMPORTED` for measured counts.
    """

    id: str
    name: str
    source: str
    materials: Mapping[str, str]
    tasks: Mapping[str, tuple[str, str]]
    license: str
    authors: tuple[str, ...]
    notes: str
    origin: bids.Origin = "RECONSTRUCTION"


OKAMOTO2012 = StudyText(
    id="okamoto2012",
    name="Identification of virtual and real crinkled materials by a footstep",
    source="S. Okamoto, S. Ishikawa, H. Nagano, Y. Yamada: Spectrum-based synthesis of vibrotactile stimuli: active "
    "footstep display for crinkle of fragile structures, Tables 1 and 2",
    materials={
        "copy paper": "cylinder of copy paper, 65 g/m2, 80 um",
        "aluminum foil": "cylinder of aluminum foil, 30 g/m2, 11 um",
        "polypropylene": "cylinder of polypropylene film, 27 g/m2, 30 um",
        "typing paper": "cylinder of typing paper, 50 g/m2, 35 um",
    },
    tasks={
        "virtual": (
            "Task 1: virtual stimuli",
            "Step on the panel at any speed; say which of the four materials it was. Ten trials per material, "
            "random order; vibration synthesized from recorded spectra.",
        ),
        "real": (
            "Task 2: real stimuli",
            "Step on the thin panel that covers the cylinder; say which of the four materials it was. Ten trials per "
            "material, random order.",
        ),
    },
    license="MIT",
    authors=("The palpate developers",),
    notes="The cells printed for polypropylene in Table 1 add up to 0.973, which is impossible with ten answers per "
    "row. One possible explanation, assumed here, is three trials without an answer.",
)
"""Section 5 and Tables 1 and 2 of the paper; materials as section 2 gives them."""


STUDIES = {OKAMOTO2012.id: OKAMOTO2012}
"""Published studies whose texts are held here, by id."""


def check_study_id(study: str) -> None:
    """Raise `DatasetError` for a text that is no id of a study."""
    if not re.fullmatch(r"[a-z][a-z0-9]*", study):
        raise DatasetError("study", f"got {quoted(study)}", "choose another id", allowed="lowercase letters and digits")


def study_text(
    study: str,
    counts: Mapping[str, Path],
    source: str | None = None,
    *,
    measured: bool = False,
    stated: Stated = NOTHING_STATED,
) -> StudyText:
    """Return the texts of a study in `STUDIES`, or what the counts files of another tell.

    `counts` maps task ids to counts files; another study needs its `source`. Counts that a laboratory `measured` have
    only the order of materials and the titles of a paper. Raises `DatasetError` for a bad id or file, or no source.
    """
    if source is not None:
        check_texts(Path("--source"), {"source": source})
    known = STUDIES.get(study)
    if known is not None and not measured:
        return known if source is None else replace(known, source=source)
    check_study_id(study)
    if source is None:
        raise DatasetError(
            f"palpate has no texts for study {study}", remedy="give the source of the counts with --source"
        )
    materials = {material: material for path in counts.values() for material in materials_of(path, stated)}
    # Only measured counts of a known study come this far: its titles are known, and the order of its materials.
    if known is not None and set(materials) <= set(known.materials):
        materials = dict(known.materials)
    titles = {task: title for task, (title, _) in known.tasks.items()} if known is not None else {}
    order = "The names and order of the materials are as in the counts files."
    return StudyText(
        id=study,
        name=f"{'Answers' if measured else 'Counts'} of {study}",
        source=source,
        materials=materials,
        tasks={task: (titles.get(task, task), "As in the source.") for task in counts},
        license="n/a: ask the laboratory" if measured else "n/a",
        authors=(f"The people who {'measured' if measured else 'made the counts of'} {study}",),
        notes="The same number means the same participant in every task." if measured else order,
        origin="IMPORTED" if measured else "RECONSTRUCTION",
    )


def import_counts(
    counts: Mapping[str, Path],
    out: Path,
    *,
    study: StudyText,
    software: Software | None = None,
    stated: Stated = NOTHING_STATED,
) -> Path:
    """Build the dataset `out` from one counts file a task, and return its folder.

    `counts` maps task ids, in the order of the tables, to files. Raises `DatasetError` for a bad file, fewer than two
    materials, a task that is not the study's, or an existing `out`.
    """
    if len({path.name for path in counts.values()}) != len(counts):
        raise DatasetError(
            f"counts files need different names: got {sorted(path.name for path in counts.values())}",
            remedy="rename them",
        )
    if unknown := set(counts) - set(study.tasks):
        raise DatasetError(
            f"no such tasks in {study.id}: {sorted(unknown)}", remedy="name those", allowed=f"{list(study.tasks)}"
        )
    tables = {task: read_counts(path, tuple(study.materials), stated) for task, path in counts.items()}
    if len(study.materials) < 2:
        raise DatasetError(
            study.id,
            f"got only one material, {', '.join(study.materials)}",
            "give the counts of the other materials too",
            allowed="two or more",
        )
    numbers = sorted({number for table in tables.values() for number in table})
    labels = {number: f"{number:0{max(2, len(str(numbers[-1])))}d}" for number in numbers}
    with new_dataset(out) as root:
        people = ({"participant_id": f"sub-{labels[n]}"} for n in numbers)
        files = bids.description(root, _description(study, tables, software or this()))
        files |= bids.participants(root, people, origin=study.origin)
        for task, table in tables.items():
            text = _task_text(study, task)
            for number in sorted(table):
                files |= bids.events(root, labels[number], text, _trials(table[number], study))
            files[root / "sourcedata" / counts[task].name] = storage.read_bytes(counts[task])
        files[root / "sourcedata" / "README"] = _source(study, counts).encode()
        bids.write_files(files)
    return out


def _trials(cells: Mapping[tuple[str, str], int], study: StudyText) -> Iterator[dict[str, object]]:
    trial = 0
    for presented in study.materials:
        for answered in (*study.materials, NO_ANSWER):
            for _ in range(cells.get((presented, answered), 0)):
                trial += 1
                yield {
                    "trial": trial,
                    "attempt": 1,
                    "counted": True,
                    "presented": presented,
                    "answered": answered,
                    "origin": study.origin,
                }


def _task_text(study: StudyText, task: str) -> bids.TaskText:
    title, instructions = study.tasks[task]
    return bids.TaskText(
        id=task,
        title=title,
        description=f"{KNOWN[study.origin].format(source=study.source)} {_unknown(study)}",
        instructions=instructions,
        materials=study.materials,
        stimulus_presentation={"SoftwareName": "not that of palpate; see the source"},
        origin=study.origin,
    )


def _unknown(study: StudyText) -> str:
    return UNKNOWN if study.origin == "RECONSTRUCTION" else f"{NO_TIME} {ORDER}"


def _description(study: StudyText, tables: Mapping[str, Counts], software: Software) -> bids.DatasetText:
    paragraphs = (
        ABOUT[study.origin].format(source=study.source),
        *(f"Task {task}: {_summary(table)}." for task, table in tables.items()),
        study.notes,
        _unknown(study),
        f"Trials without a known answer have the answer {NO_ANSWER}. The counts themselves are in sourcedata/. BIDS "
        f"requires a column `onset` in seconds; n/a there means that the onset is not known.",
    )
    return bids.DatasetText(
        study=study.id,
        name=study.name,
        origin=study.origin,
        ordered=False if study.origin == "IMPORTED" else None,
        license=study.license,
        authors=study.authors,
        tasks=tuple(tables),
        references=(study.source,),
        software=software,
        readme="\n\n".join(textwrap.fill(paragraph, 100) for paragraph in paragraphs),
    )


def _summary(table: Counts) -> str:
    answers = Counter[str]()
    for cells in table.values():
        for (_, answered), count in cells.items():
            answers[answered] += count
    people = f"{len(table)} participant{'s' if len(table) != 1 else ''}"
    return f"{people}, {answers.total()} trials, {answers[NO_ANSWER]} without an answer"


def _source(study: StudyText, counts: Mapping[str, Path]) -> str:
    copies = "\n".join(f"{path.name}: counts of task {task}, unchanged" for task, path in counts.items())
    text = f"Columns: {', '.join(COLUMNS)}. {FOUND[study.origin].format(source=study.source)}"
    return f"{bids.LABELS[study.origin]}\n\n{copies}\n\n{textwrap.fill(text, 100)}\n"
