"""What must hold before a journal counts: nothing foreign, copied, renamed or made for another purpose enters a table.

Headers are checked against path, protocol, seal, seed and roster (or the plan), and every file against the log's
anchors.
"""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from palpate.experiment import clock, storage
from palpate.experiment.dataset import register
from palpate.experiment.dataset.register import LOG, Anchor, Kept, Prefix
from palpate.experiment.errors import DatasetError, PalpateError, Remedy, RosterError
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.approval import Seal
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import chain, journal
from palpate.experiment.records.entries import Armed, Header, Purpose, Withdrawal
from palpate.experiment.records.progress import progress
from palpate.experiment.study import enrolment, schedule
from palpate.experiment.study import roster as rosters
from palpate.experiment.study.roster import Roster
from palpate.experiment.study.schedule import allocate, allocated

FARTHEST_EAST = timedelta(hours=14)
"""The day of a session's beginning is at most this much ahead of UTC, wherever it was run."""


Each = Callable[[Callable[[Path], Any], Iterable[Path]], Iterable[Any]]
"""Calls a function with each path, and gives what it returns."""

OPEN = "no footer ends it: its session is running or was cut off, so tables may lack its last trials"
"""What is said of a journal whose session is open."""


@dataclass(frozen=True)
class Believed:
    """A dataset whose journals were all checked.

    `tasks` are those of every participant in order, concealed until they begin. `roster` is None in a rehearsal and in
    practice. `sessions` are the headers by journal. Those `under_way` have no footer at their end.
    """

    protocol: Protocol
    purpose: Purpose
    tasks: Mapping[str, tuple[str, ...]]
    roster: Roster | None
    sessions: tuple[tuple[Path, Header], ...]
    under_way: frozenset[Path]


class Plan(BaseModel):
    """What is rehearsed or practiced, saved in the dataset so that it can continue; `label` says which of the two."""

    model_config = ConfigDict(frozen=True, strict=True)

    format: Literal[1] = storage.DATASET_FORMAT
    label: Literal["REHEARSAL", "PRACTICE"] = "REHEARSAL"
    protocol_sha256: str
    rig_sha256: str
    participants: int
    seed: int
    control: Literal["none", "silence"]
    real_time: bool

    @property
    def what(self) -> str:
        """What it is of, in words."""
        return "a rehearsal" if self.label == "REHEARSAL" else "practice"


@dataclass(frozen=True)
class _Study:
    """What the headers of a dataset are held against: a `plan`, or `roster` and `seal` of a study."""

    root: Path
    protocol: Protocol
    protocol_sha256: str
    purpose: Purpose
    seed: int
    tasks: dict[str, tuple[str, ...]]
    plan: Plan | None
    roster: Roster | None
    seal: Seal | None


ALONE = {"RECONSTRUCTION": "only counts from print", "IMPORTED": "only what was imported"}
"""What stands behind tables that never had a journal, by their origin."""


def has_journals(root: Path) -> bool:
    """Return whether a dataset was made from journals, even if some are gone; others hold tables alone."""
    source = root / "sourcedata"
    settled = (storage.seed_path(root), storage.plan_path(root), storage.roster_path(root))
    return any(path.exists() for path in settled) or any(source.glob("sub-*/sub-*"))


def origin_of(root: Path) -> str:
    """Return what the tables of a dataset say that they are. Raises `DatasetError` if they say nothing."""
    try:
        return str(storage.json_of(storage.read_bytes(root / "dataset_description.json"))["Palpate"]["Origin"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DatasetError(root, "is no dataset of palpate", "give the folder that holds sourcedata") from error


def journals(root: Path) -> list[Path]:
    """Return the journals of a dataset, by participant and task; those too of which only the head is there."""
    heads = (root / "sourcedata").glob("sub-*/sub-*_journal.head")
    return sorted({*storage.journals(root), *(head.with_suffix(".jsonl") for head in heads)})


def believed(root: Path, each: Each = map) -> Believed:
    """Return a dataset whose every journal was read and checked.

    Raises `DatasetError`, `JournalError`, `ProtocolError` or `RosterError` for the first file that does not fit.
    """
    dataset, doubts = doubted(root, each)
    for doubt in doubts:
        raise doubt
    return dataset


def doubted(root: Path, each: Each = map) -> tuple[Believed, list[PalpateError]]:
    """Return `examined`, with an error too for each difference from an anchor in the log. Raises as `examined`."""
    dataset, doubts = examined(root, each)
    return dataset, [*(doubt for _, doubt in _unlike_anchors(root, dataset.roster)), *doubts]


def check_roster(root: Path) -> int:
    """Return the wall time of a roster's last line, ns, 0 without one, if a line may be added to it.

    Raises `RosterError` or `DatasetError` if an anchor in the log, a journal or a withdrawal knows lines that the
    roster lacks, or if the participants are simulated.
    """
    enrolment.refuse_rehearsal(root)
    file = storage.roster_path(root)
    roster = Roster.load(file)
    for name, doubt in _unlike_anchors(root, roster):
        if root / name == file:
            raise doubt
    marks: dict[str, Path] = {}
    for path in storage.journals(root):
        try:
            contents = journal.read_if_begun(path)
        except PalpateError:
            # Somebody withdraws from a dataset with a damaged journal too; `build` and `verify` tell of it.
            continue
        if contents.lines:
            roster.as_of(contents.header.roster_sha256)
        if any(isinstance(entry, Withdrawal) for entry in contents.entries):
            marks[path.parent.name.removeprefix("sub-")] = path
    _check_withdrawals(roster, root, marks)
    return roster.lines.links[-1].t_ns if roster.lines.links else 0


def anchor(root: Path) -> Anchor:
    """Return the dataset's anchor. Raises `DatasetError` without roster and session, and as `believed`."""
    dataset = believed(root)
    if dataset.roster is None and not dataset.sessions:
        raise DatasetError(root, "got no session", "run a session first, then anchor it", allowed="one or more")
    return Anchor(
        anchored_utc=clock.utc(clock.wall_ns()),
        study=dataset.protocol.study.id,
        purpose=dataset.purpose,
        protocol_sha256=approval.sha256(dataset.protocol),
        seal_sha256=seal_sha256(root),
        prefixes=tuple(
            Prefix(file=path.relative_to(root).as_posix(), lines=len(hashes), sha256=hashes[-1])
            for path in (storage.roster_path(root), *(path for path, _ in dataset.sessions))
            if (hashes := register.line_hashes(path))
        ),
    )


def seal_sha256(root: Path) -> str | None:
    """Return the hash of the file of a dataset's seal; None where there is none."""
    path = approval.seal_path(storage.protocol_path(root))
    return hashlib.sha256(storage.read_bytes(path)).hexdigest() if path.exists() else None


def keep_anchor(root: Path) -> tuple[Anchor, bool]:
    """Anchor a dataset in its log; return the anchor, or the last one if nothing was added, and whether it is new.

    Raises as `anchor`, and if the log cannot be written.
    """
    made = anchor(root)
    kept, _ = register.read(root / LOG) if (root / LOG).exists() else ((), ())
    if kept and kept[-1].anchor == made.model_copy(update={"anchored_utc": kept[-1].anchor.anchored_utc}):
        return kept[-1].anchor, False
    register.append(root / LOG, Kept(anchor=made))
    return made, True


def examined(root: Path, each: Each = map) -> tuple[Believed, list[PalpateError]]:
    """Return what can be believed of a dataset, and an error for whatever else does not fit.

    `each` is `map` or that of a pool of processes. Raises as `believed` for protocol, seal, seed, roster or plan.
    """
    study = _study(root)
    sessions: list[tuple[Path, Header]] = []
    withdrawals: dict[str, Path] = {}
    open_ended: set[Path] = set()
    doubts: list[PalpateError] = []
    paths = journals(root)
    begun = set(paths)
    roster = study.roster or Roster(storage.roster_path(root))
    with collected(doubts):
        _refuse_erased(root, roster)
    with collected(doubts):
        _refuse_strays(root, set(paths))
    held = [path for path in paths if not roster.has_erased(str(path))]
    for path, (header, state, failed) in zip(held, each(partial(_looked_at, study), held), strict=True):
        doubts += failed
        if header is not None:
            sessions.append((path, header))
            if state == "withdrawn":
                withdrawals[header.participant] = path
            elif state == "under way":
                open_ended.add(path)
        elif not failed:
            begun.discard(path)
    with collected(doubts):
        # Raw frames without a journal: a whole session was deleted.
        known = {storage.foot_path(path) for path in paths}
        for path in sorted((root / "sourcedata").glob("sub-*/*_foot.cobs")):
            if path not in known and storage.size(path):
                raise DatasetError(path, "the journal of these frames is missing", "restore it from a backup")
    with collected(doubts):
        by_id: dict[str, Path] = {}
        for path, header in sessions:
            if (other := by_id.setdefault(header.session_id, path)) != path:
                raise DatasetError(
                    path, f"has the session_id of {other}", "take the copy out", allowed="one of its own"
                )
    with collected(doubts):
        _refuse_tables(root, begun, roster)
    with collected(doubts):
        _refuse_people(root, begun, {who: of for who, of in study.tasks.items() if who not in roster.erased})
    if study.roster is not None:
        with collected(doubts):
            _check_withdrawals(roster, root, withdrawals)
    dataset = Believed(study.protocol, study.purpose, study.tasks, study.roster, tuple(sessions), frozenset(open_ended))
    return dataset, doubts


def _looked_at(
    study: _Study, path: Path
) -> tuple[Header | None, Literal["withdrawn", "under way", "ended"], list[PalpateError]]:
    """Return the header of a journal, None before its session or with an error, its state, and the errors."""
    doubts: list[PalpateError] = []
    with collected(doubts):
        contents = journal.read_if_begun(path)
        # Raw frames of an attempt of which the journal does not know: the journal was cut off.
        foot = storage.foot_path(path)
        if storage.size(foot) and not any(isinstance(entry, Armed) for entry in contents.entries):
            raise DatasetError(path, f"knows of no attempt, and {foot.name} does", "restore the journal from a backup")
        if contents.lines:
            _check_header(path, header := contents.header, study)
            if any(isinstance(entry, Withdrawal) for entry in contents.entries):
                return header, "withdrawn", doubts
            return header, "under way" if progress(contents.entries).footer is None else "ended", doubts
    return None, "ended", doubts


@contextmanager
def collected(doubts: list[PalpateError]) -> Iterator[None]:
    """Add the error that ends the block to `doubts`, and go on after it."""
    try:
        yield
    except PalpateError as doubt:
        doubts.append(doubt)


def _study(root: Path) -> _Study:
    storage.refuse_other_format(root)
    kept = storage.protocol_path(root)
    if not kept.exists() and not has_journals(root):
        got = "holds no study" if root.is_dir() else "is no folder"
        raise DatasetError(
            root,
            got,
            "give that one, or restore its sourcedata from a backup",
            allowed="the folder of a study's dataset, which holds sourcedata",
        )
    protocol = files.load(kept)
    sha256 = approval.sha256(protocol)
    plan_file = storage.plan_path(root)
    if not plan_file.exists():
        seed, purpose = enrolment.seed_of(root), enrolment.purpose_of(root)
        roster = Roster.load(storage.roster_path(root))
        tasks = {one.participant: one.tasks for one in allocated(protocol, seed, roster.takes)}
        seal = approval.held(kept, protocol) if any(storage.size(path) for path in storage.journals(root)) else None
        return _Study(root, protocol, sha256, purpose, seed, tasks, None, roster, seal)
    try:
        plan = Plan.model_validate_json(storage.read_bytes(plan_file))
    except (OSError, ValidationError) as error:
        raise DatasetError(
            plan_file, "is no plan of a rehearsal or of practice", "restore it, or begin anew"
        ) from error
    for path in (storage.roster_path(root), storage.seed_path(root)):
        if path.exists():
            raise DatasetError(path, f"stands in the dataset of {plan.what}", "take it out of there", allowed="none")
    if plan.protocol_sha256 != sha256:
        raise DatasetError(kept, f"is not the protocol of this {plan.label}", "restore it, or begin anew")
    tasks = {one.participant: one.tasks for one in allocate(protocol, plan.seed)[: plan.participants]}
    return _Study(root, protocol, sha256, plan.label, plan.seed, tasks, plan, None, None)


def _unlike_anchors(root: Path, roster: Roster | None) -> Iterator[tuple[str, DatasetError]]:
    """Give each file that was not erased and does not begin as an anchor in the dataset's log has it, with an error."""
    kept, broken = register.read(root / LOG) if (root / LOG).exists() else ((), ())
    if broken and not kept:
        yield LOG.as_posix(), DatasetError(root / LOG, "holds no anchor that can be read", "restore it from a backup")
    known: dict[str, tuple[str, ...]] = {}
    told: set[str] = set()
    # The latest anchor is the one that says most.
    for one in reversed(kept):
        for prefix in one.anchor.prefixes:
            if prefix.file in told or (roster is not None and roster.has_erased(prefix.file)):
                continue
            if prefix.file not in known:
                known[prefix.file] = register.line_hashes(root / prefix.file)
            if not prefix.begins(hashes := known[prefix.file]):
                told.add(prefix.file)
                found = f"now has {len(hashes)}" if len(hashes) < prefix.lines else "now begins with others"
                day = one.anchor.anchored_utc[:10]
                lines = "1 line" if prefix.lines == 1 else f"{prefix.lines} lines"
                had = f"had {lines} by the anchor of {day} in {LOG}, and {found if hashes else 'is missing'}"
                yield prefix.file, DatasetError(root / prefix.file, had, "restore it from a backup")


def _refuse_erased(root: Path, roster: Roster) -> None:
    """Refuse what is there of a participant whose data were erased: a kill left it, or a backup brought it back."""
    for participant in sorted(roster.erased):
        for path in storage.left_of(root, participant):
            raise DatasetError(
                path,
                f"the data of participant {participant} were erased, as the roster says, and this is here",
                _finish(root, roster, participant),
            )


def unfinished(root: Path, roster: Roster) -> dict[str, Remedy]:
    """Return what finishes each interrupted withdrawal, by participant: in journals, files or the table."""
    table = root / "participants.tsv"
    told = {row.get("participant_id"): row.get("withdrawn") for row in _rows(table)} if table.is_file() else {}
    return {
        participant: _finish(root, roster, participant)
        for participant in roster.withdrawn
        if told.get(f"sub-{participant}", "1") != "1"
        or not _is_marked(root, participant)
        or (participant in roster.erased and (f"sub-{participant}" in told or storage.left_of(root, participant)))
    }


def _is_marked(root: Path, participant: str) -> bool:
    """Return whether a participant's withdrawal stands outside of the roster: in all their journals, or by itself."""
    own = [path for path in storage.journals(root) if path.parent == storage.participant_folder(root, participant)]
    begun = [content for content in map(storage.read_bytes, own) if b"\n" in content]
    told = begun and all(b'"kind":"withdrawal"' in content for content in begun)
    return bool(told) or storage.withdrawal_path(root, participant).exists()


def _finish(root: Path, roster: Roster, participant: str) -> Remedy:
    """Return what finishes the withdrawal of a participant."""
    erased, given = participant in roster.erased, ("--reason", roster.withdrawn[participant], "--dataset", str(root))
    command = ("palpate", "withdraw", str(storage.protocol_path(root)), "-p", participant, *given)
    choice = "" if erased else ", with --erase if their data are to go"
    words = f"the withdrawal of participant {participant} is finished by the same command{choice}: {{}}"
    return Remedy(words, (*command, "--erase") if erased else command)


def _rows(table: Path) -> list[dict[str, str]]:
    """Return the rows of a table, whatever it is, by its columns."""
    lines = storage.read_bytes(table).decode("utf-8", "replace").split("\n")
    columns, *rows = (line.split("\t") for line in lines)
    return [dict(zip(columns, row, strict=False)) for row in rows]


def _refuse_strays(root: Path, journals: set[Path]) -> None:
    """Refuse what looks like a journal and stands where none is read from: a copy, or another dataset."""
    roster = storage.roster_path(root)
    known = {*journals, *(chain.head_path(path) for path in journals), roster, chain.head_path(roster)}
    source = root / "sourcedata"
    found = {path for path in source.rglob("*") if path.suffix in (".jsonl", ".head") or "_journal" in path.name}
    for path in sorted({*found, *root.rglob("*_journal.jsonl")} - known):
        raise DatasetError(
            path,
            "looks like a journal, and no session of this dataset writes one there",
            "take it out of the dataset",
            allowed="sourcedata/sub-P/sub-P_task-T_journal.jsonl",
        )


def _check_header(path: Path, header: Header, study: _Study) -> None:
    """Refuse a journal that is not of this path, this study, and its purpose."""
    participant, task = header.participant, header.task
    if path != (own := storage.journal_path(study.root, participant, task)):
        raise _foreign(path, f"participant {participant}, task {task}", str(own.relative_to(study.root)))
    known = study.tasks.get(participant)
    if known is None:
        raise _foreign(path, f"participant {participant}", f"{min(study.tasks)} to {max(study.tasks)}, as planned")
    if task not in known:
        raise _foreign(path, f"task {task}", f"{', '.join(known)}, the tasks of participant {participant}")
    plan = study.plan
    expected = {
        "purpose": study.purpose,
        "study": study.protocol.study.id,
        "protocol_sha256": study.protocol_sha256,
        "seed": study.seed,
        "task_position": known.index(task) + 1,
        "block_trials": schedule.block_trials(study.protocol, task),
        **({"rig_sha256": plan.rig_sha256} if plan else {}),
        **({"session_id": header.rehearsed_id(plan.control)} if plan and plan.label == "REHEARSAL" else {}),
    }
    for name, allowed in expected.items():
        if (got := getattr(header, name)) != allowed:
            raise _foreign(path, f"{name} {got}", f"{allowed}, as everywhere in this dataset")
    seed, presents = study.seed, study.protocol.presented(study.protocol.task(task))
    if foreign := sorted({one for trial in header.order for one in trial.presented}.difference(presents)):
        raise _foreign(path, f"trials with {', '.join(foreign)}", f"{', '.join(presents)}, which task {task} presents")
    if header.order != schedule.schedule(protocol=study.protocol, participant=participant, task_id=task, seed=seed):
        raise _foreign(path, "another order of trials", "the one that protocol and seed give")
    if study.roster is not None and study.seal is not None:
        _check_enrolment(path, header, study.roster, study.seal, study.protocol)


def _foreign(path: Path, got: str, allowed: str) -> DatasetError:
    return DatasetError(
        path,
        f"is not of this dataset: its header has {got}",
        "take the journal out of the dataset, or put it back where it came from",
        allowed=allowed,
    )


def _check_enrolment(path: Path, header: Header, roster: Roster, seal: Seal, protocol: Protocol) -> None:
    """Refuse a session of somebody who had not enrolled and consented before, or had withdrawn."""
    try:
        roster.as_of(header.roster_sha256).may_run(header.participant, protocol, approved_on=date.min, today=date.max)
        rosters.check_consent(
            header.participant,
            roster.consent_on[header.participant],
            approved_on=seal.approved_on,
            today=(datetime.fromisoformat(header.started_utc) + FARTHEST_EAST).date(),
        )
    except RosterError as error:
        raise RosterError(path, f"the session was not allowed to begin: {error}") from error


def _refuse_tables(root: Path, journals: set[Path], roster: Roster) -> None:
    """Refuse tables of a session without a journal; those of whose data were erased are refused already."""
    begun = {path.name.removesuffix("journal.jsonl") for path in journals}
    for path in sorted(root.glob("sub-*/beh/sub-*_task-*")):
        who, task = path.name.split("_")[:2]
        if f"{who}_{task}_" not in begun and who.removeprefix("sub-") not in roster.erased:
            raise DatasetError(
                path,
                "no journal gives this table",
                "restore the journal under sourcedata from a backup, or take the table out of the dataset",
            )


def _refuse_people(root: Path, journals: set[Path], tasks: dict[str, tuple[str, ...]]) -> None:
    """Refuse a table that knows a participant, or the first task of one, of whom no journal is there."""
    table = root / "participants.tsv"
    if not table.is_file():
        return
    for row in _rows(table):
        participant, first = row.get("participant_id", "").removeprefix("sub-"), row.get("first_task", "")
        own = {storage.journal_path(root, participant, task): task for task in tasks.get(participant, ())}
        wanted = {path for path, task in own.items() if task == first} or own.keys()
        if wanted and journals.isdisjoint(wanted):
            raise DatasetError(
                min(wanted),
                f"is missing, and {table.name} has a session of participant {participant}; restore the journal from a "
                "backup",
                build_again(
                    root,
                    f"if no such session took place, {table.name} was edited: delete that, and make it again",
                    suffices=False,
                ),
            )


def build_again(root: Path, words: str, *, suffices: bool = True) -> Remedy:
    """Return the remedy whose command makes the tables of a dataset."""
    return Remedy(words, ("palpate", "build", str(root)), suffices)


def _check_withdrawals(roster: Roster, root: Path, marks: dict[str, Path]) -> None:
    """Refuse a roster that has forgotten a withdrawal; `marks` are the journals that hold one."""
    files = (root / "sourcedata").glob("sub-*/sub-*_withdrawn.json")
    for participant, path in (marks | {file.parent.name.removeprefix("sub-"): file for file in files}).items():
        if participant not in roster.withdrawn:
            raise RosterError(
                roster.path,
                f"participant {participant} withdrew, as {path} says, and the roster does not",
                "restore the roster from a backup",
            )
