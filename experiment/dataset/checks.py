"""What a dataset has to be before a journal counts: `CHECKS` is the list, and each is a function of a `Dataset`.

Nothing foreign, copied, renamed or made for another purpose enters a table. Headers are checked against path, protocol,
seal, seed and roster (or the plan), and every file against the log's anchors. A reader runs the list as far as it
wants: `load_sound` stops at the first refusal, `palpate status` shows all, `palpate verify` every check there is.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import date, datetime, timedelta
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, overload

from pydantic import BaseModel, ConfigDict, ValidationError

from palpate.experiment import clock, storage
from palpate.experiment.dataset import register
from palpate.experiment.dataset.register import LOG, Anchor, Kept, Prefix
from palpate.experiment.errors import DatasetError, Finding, PalpateError, Remedy, RosterError
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import chain, journal
from palpate.experiment.records.entries import Armed, Header, Purpose, Trained, Withdrawal
from palpate.experiment.records.progress import progress
from palpate.experiment.study import approvals, enrolment, schedule
from palpate.experiment.study import roster as rosters
from palpate.experiment.study.approvals import Approvals
from palpate.experiment.study.roster import Roster
from palpate.experiment.study.schedule import allocate, allocated

FARTHEST_EAST, FARTHEST_WEST = timedelta(hours=14), timedelta(hours=-12)
"""The day of a session's beginning is at most this much ahead of UTC, and behind it, wherever it was run."""

Each = Callable[[Callable[[Path], Any], Iterable[Path]], Iterable[Any]]
"""Calls a function with each path, and gives what it returns."""

OPEN = "it has no footer: the session is running or was interrupted, so tables may lack its last trials"
"""What is said of a journal whose session is open."""


class Plan(BaseModel):
    """What is rehearsed or practiced, saved in the dataset so that it can continue; `label` says which of the two."""

    model_config = ConfigDict(frozen=True, strict=True)

    format: storage.DatasetFormat = storage.DATASET_FORMAT
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
class Sessions:
    """A dataset's folder, with the headers of journals that are whole, whatever else is wrong."""

    root: Path
    sessions: tuple[tuple[Path, Header], ...] = field(default=(), kw_only=True)


@dataclass(frozen=True)
class Dataset(Sessions):
    """A dataset on disk, with all its journals read.

    A simulation has a `plan`, a study a `roster`, and `approvals` once a session began or an approval was amended.
    `protocol` is the version of the latest, `versions` has every version by its hash. `tasks` are those of every
    participant in order, concealed until they begin, `groups` their groups, empty without any. `sessions` are the
    headers of journals that fit, `under_way` those of them without a footer at their end, `withdrawals` the ones that
    record that their participant withdrew. `begun` are the journals of every session, damaged ones too, and `damage` is
    what is wrong with single ones. Sessions of which one is refused are not `whole`.
    """

    protocol: Protocol
    purpose: Purpose
    seed: int
    tasks: Mapping[str, tuple[str, ...]]
    plan: Plan | None = None
    roster: Roster | None = None
    approvals: Approvals | None = None
    versions: Mapping[str, Protocol] = field(default_factory=dict)
    under_way: frozenset[Path] = frozenset()
    withdrawals: frozenset[Path] = frozenset()
    begun: frozenset[Path] = frozenset()
    damage: tuple[Finding, ...] = ()
    groups: Mapping[str, str] = field(default_factory=dict)
    whole: bool = True

    @property
    def people(self) -> Roster:
        """The roster, an empty one of a simulation."""
        return self.roster or Roster(storage.roster_path(self.root))

    def version(self, header: Header) -> Protocol:
        """The version of the protocol under which a session began."""
        return self.versions.get(header.protocol_sha256, self.protocol)


def has_journals(root: Path) -> bool:
    """Return whether a dataset was made from journals, even if some are gone; others hold tables alone."""
    settled = (storage.seed_path(root), storage.plan_path(root), storage.roster_path(root))
    return any(path.exists() for path in settled) or any((root / "sourcedata").glob("sub-*/sub-*"))


def journals(root: Path) -> list[Path]:
    """Return the journals of a dataset, by participant and task; those too of which only the head is there."""
    heads = (root / "sourcedata").glob("sub-*/sub-*_journal.head")
    return sorted({*storage.journals(root), *(head.with_suffix(".jsonl") for head in heads)})


def load_sound(root: Path, each: Each = map) -> Dataset:
    """Return a dataset that passes every check. Raises as `load`, and `DatasetError` for the first refusal."""
    dataset = load(root, each)
    for one in findings(dataset):
        if one.refuses:
            raise DatasetError.at(one)
    return dataset


@overload
def findings(dataset: Dataset, *names: str) -> Iterator[Finding]: ...
@overload
def findings(dataset: Sessions, *names: Literal["rigs", "recordings", "companions"]) -> Iterator[Finding]: ...
def findings(dataset: Sessions, *names: str) -> Iterator[Finding]:
    """Yield each thing that speaks against a dataset once, with the name of its check, in the order of `CHECKS`.

    Without `names` of checks, all are run but `OF_FILES` and `OF_TABLES`; these make sense of sound journals alone.
    """
    known: set[Finding] = set()
    for name in names or [name for name in CHECKS if name not in (*OF_TABLES, *OF_FILES)]:
        for one in CHECKS[name](dataset) if isinstance(dataset, Dataset) else OF_FILES[name](dataset):
            finding = replace(one, check=name)
            if finding not in known:
                known.add(finding)
                yield finding


def check_roster(root: Path) -> int:
    """Return the wall time of a roster's last line, ns, 0 without one, if a line may be added to it.

    Raises `RosterError` or `DatasetError` if an anchor in the log, a journal or a withdrawal knows lines that the
    roster lacks, or if the participants are simulated.
    """
    enrolment.refuse_rehearsal(root)
    roster = Roster.load(storage.roster_path(root))
    for finding in register.log_findings(root, roster):
        if finding.where == roster.path:
            raise DatasetError.at(finding)
    marked: list[Path] = []
    for path in storage.journals(root):
        try:
            contents = journal.read_if_begun(path)
        except PalpateError:
            # Somebody withdraws from a dataset with a damaged journal too; `build` and `verify` tell of it.
            continue
        if contents.lines:
            roster.as_of(contents.header.roster_sha256)
        if any(isinstance(entry, Withdrawal) for entry in contents.entries):
            marked.append(path)
    for finding in _forgotten_withdrawals(root, roster, marked):
        raise RosterError.at(finding)
    return roster.lines.links[-1].t_ns if roster.lines.links else 0


def anchor(root: Path) -> Anchor:
    """Return the dataset's anchor. Raises `DatasetError` without roster and session, and as `load_sound`."""
    dataset = load_sound(root)
    if dataset.roster is None and not dataset.sessions:
        raise DatasetError(root, "has no sessions", "run a session first, then make an anchor", allowed="one or more")
    return Anchor(
        anchored_utc=clock.utc(clock.wall_ns()),
        study=dataset.protocol.study.id,
        purpose=dataset.purpose,
        protocol_sha256=approval.sha256(dataset.protocol),
        seal_sha256=dataset.approvals.approved[-1].seal_sha256 if dataset.approvals is not None else None,
        prefixes=tuple(
            Prefix(file=path.relative_to(root).as_posix(), lines=len(hashes), sha256=hashes[-1])
            for path in (storage.roster_path(root), *(path for path, _ in dataset.sessions))
            if (hashes := register.line_hashes(path))
        ),
    )


def seals(root: Path) -> tuple[str, ...]:
    """Return the hashes of the file of each seal of a dataset, in both forms, oldest first; none without a seal."""
    kept = {storage.protocol_path(root): None, **dict.fromkeys(storage.protocol_paths(root))}
    return tuple(form for path in kept if approval.seal_path(path).exists() for form in approvals.seal_forms(path))


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


def load(root: Path, each: Each = map) -> Dataset:
    """Return a dataset, whatever its journals are; `each`, `map` or that of a pool of processes, reads them.

    Raises `DatasetError`, `ProtocolError` or `RosterError` for protocol, seal, seed, roster or plan.
    """
    settled, paths = _expected(root), journals(root)
    kept = [path for path in paths if not settled.people.has_erased(str(path))]
    read = dict(zip(kept, each(partial(_read_journal, settled), kept), strict=True))
    return replace(
        settled,
        sessions=tuple((path, header) for path, (header, _, _) in read.items() if header),
        under_way=frozenset(path for path, (_, state, _) in read.items() if state == "under way"),
        withdrawals=frozenset(path for path, (_, state, _) in read.items() if state == "withdrawn"),
        begun=frozenset(paths).difference(one for one, (header, _, wrong) in read.items() if not (header or wrong)),
        damage=tuple(wrong for _, _, wrong in read.values() if wrong),
    )


def _read_journal(
    dataset: Dataset, path: Path
) -> tuple[Header | None, Literal["withdrawn", "under way", "ended"], Finding | None]:
    """Return the header of a journal, None before its session or where it is wrong, its state, and what is wrong."""
    try:
        contents = journal.read_if_begun(path)
        # Raw data of an attempt unknown to the journal: that was cut off. Force begins with the session, before any.
        unknown = not any(isinstance(entry, Armed | Trained) or entry.frames for entry in contents.entries)
        for raw in (storage.raw_path(path, end) for end in storage.RAW[: 1 if contents.lines else 2] if unknown):
            if storage.size(raw):
                what = f"records no attempt, but {raw.name} contains data"
                raise DatasetError(path, what, "restore the journal from a backup")
        if not contents.lines:
            return None, "ended", None
        _check_header(path, header := contents.header, dataset)
    except PalpateError as error:
        return None, "ended", error.finding
    if any(isinstance(entry, Withdrawal) for entry in contents.entries):
        return header, "withdrawn", None
    return header, "under way" if progress(contents.entries).footer is None else "ended", None


def _expected(root: Path) -> Dataset:
    """Return what the journals of a dataset have to fit. Raises as `load`."""
    storage.refuse_other_format(root)
    kept = storage.protocol_path(root)
    if not kept.exists() and not has_journals(root):
        got = "does not contain a study" if root.is_dir() else "is not a folder"
        allowed = "the folder of a study's dataset, which contains sourcedata"
        raise DatasetError(root, got, "give the right folder, or restore its sourcedata from a backup", allowed=allowed)
    if storage.shared_path(root).exists():
        raise DatasetError(root, "is a shared copy without journals", allowed="palpate verify and analyse")
    protocol = files.load(kept)
    plan_file = storage.plan_path(root)
    if not plan_file.exists():
        seed, purpose = enrolment.seed_of(root), enrolment.purpose_of(root)
        roster = Roster.load(storage.roster_path(root))
        versions = {approval.sha256(protocol): protocol, **dict(_later_versions(root, roster))}
        *_, latest = versions.values()
        drawn = allocated(latest, seed, roster.takes)
        tasks, groups = ({one.participant: one.tasks for one in drawn}, {one.participant: one.group for one in drawn})
        known = None
        if roster.approved or any(storage.size(path) for path in storage.journals(root)):
            # Nobody was run under the first approval where an amendment came before the first session.
            if not roster.approved or approval.seal_path(kept).exists():
                approval.dataset_seal(kept, protocol)
            known = roster.approvals(approvals.read_first(root))
        return Dataset(
            root, latest, purpose, seed, tasks, roster=roster, approvals=known, versions=versions, groups=groups
        )
    try:
        plan = Plan.model_validate_json(storage.read_bytes(plan_file))
    except (OSError, ValidationError) as error:
        raise DatasetError(plan_file, "is not a rehearsal or practice plan", "restore it, or start again") from error
    for path in (storage.roster_path(root), storage.seed_path(root)):
        if path.exists():
            raise DatasetError(path, f"does not belong to {plan.what}", "move it elsewhere", allowed="none")
    if plan.protocol_sha256 != approval.sha256(protocol):
        raise DatasetError(kept, f"is not the protocol of this {plan.label}", "restore it, or start again")
    drawn = allocate(protocol, plan.seed)[: plan.participants]
    tasks, groups = ({one.participant: one.tasks for one in drawn}, {one.participant: one.group for one in drawn})
    return Dataset(root, protocol, plan.label, plan.seed, tasks, plan, groups=groups)


def _later_versions(root: Path, roster: Roster) -> Iterator[tuple[str, Protocol]]:
    """Yield the protocol of each approval after the first. Raises `DatasetError` where it or its seal is another."""
    for one in roster.approved:
        path = storage.protocol_path(root, one.number)
        for file in (path, approval.seal_path(path)):
            if not file.exists():
                raise DatasetError(file, "is listed in the roster but is missing", "restore it from a backup")
        protocol = files.load(path)
        if approval.sha256(protocol) != one.protocol_sha256 or approvals.seal_sha256(path) != one.seal_sha256:
            what = f"this file or its seal does not match approval {one.number} in the roster"
            raise DatasetError(path, what, "restore both from a backup")
        yield one.protocol_sha256, protocol


def _anchors(dataset: Dataset) -> Iterator[Finding]:
    """Yield each file that was not erased and is not as the dataset's log of anchors has it."""
    return register.log_findings(dataset.root, dataset.people, (dataset.protocol.study.id, dataset.purpose))


def _erased(dataset: Dataset) -> Iterator[Finding]:
    """Yield what is there of a participant whose data were erased: a kill left it, or a backup brought it back."""
    for participant in sorted(dataset.people.erased):
        left = dataset.people.left_of(dataset.root, participant)
        files = [one for path in left for one in (path, *path.rglob("*")) if not one.is_dir()] or left
        for path in sorted(files, key=lambda path: (path.suffix != ".jsonl", path.name[:4] != "sub-"))[:1]:
            these = f"this and {len(files) - 1} of their other files are" if len(files) > 1 else "this file is"
            what = f"the roster records that the data of participant {participant} were erased, but {these} here"
            yield Finding(what, path, remedy=finish_withdrawal(dataset.root, dataset.people, participant))


def finish_withdrawal(root: Path, roster: Roster, participant: str) -> Remedy:
    """Return what finishes the withdrawal of a participant."""
    erased, given = participant in roster.erased, ("--reason", roster.withdrawn[participant], "--dataset", str(root))
    command = ("palpate", "withdraw", str(storage.protocol_path(root)), "-p", participant, *given)
    choice = "" if erased else " (add --erase to erase their data)"
    words = f"to finish the withdrawal of participant {participant}, run the same command again{choice}: {{}}"
    return Remedy(words, (*command, "--erase") if erased else command)


def table_rows(table: Path) -> list[dict[str, str]]:
    """Return the rows of a table, whatever it is, by its columns; none where it is missing."""
    if not table.is_file():
        return []
    lines = storage.read_bytes(table).decode("utf-8", "replace").split("\n")
    columns, *rows = (line.split("\t") for line in lines)
    return [dict(zip(columns, row, strict=False)) for row in rows]


def _strays(dataset: Dataset) -> Iterator[Finding]:
    """Yield what looks like a journal and stands where none is read from: a copy, or another dataset."""
    root, roster = dataset.root, dataset.people.path
    paths = journals(root)
    known = {*paths, *(chain.head_path(path) for path in paths), roster, chain.head_path(roster)}
    source = root / "sourcedata"
    found = {path for path in source.rglob("*") if path.suffix in (".jsonl", ".head") or "_journal" in path.name}
    for path in sorted({*found, *root.rglob("*_journal.jsonl")} - known):
        if path.name.startswith("._"):
            # What macOS leaves beside each file is no journal.
            continue
        what = "looks like a journal, but no session in this dataset writes a journal there"
        allowed = "sourcedata/sub-P/sub-P_task-T_journal.jsonl"
        yield Finding(what, path, allowed=allowed, remedy="move it out of the dataset")


def _frames_alone(dataset: Dataset) -> Iterator[Finding]:
    """Yield raw data without a journal: a whole session was deleted."""
    known = {storage.raw_path(path, end) for path in journals(dataset.root) for end in storage.RAW}
    source = dataset.root / "sourcedata"
    for path in sorted(path for end in storage.RAW for path in source.glob(f"sub-*/*_{end}")):
        if path not in known and storage.size(path):
            yield Finding("the journal for these frames is missing", path, remedy="restore it from a backup")


def _copies(dataset: Dataset) -> Iterator[Finding]:
    """Yield each journal of a session that another journal has already."""
    by_id: dict[str, Path] = {}
    for path, header in dataset.sessions:
        if (other := by_id.setdefault(header.session_id, path)) != path:
            what, allowed = f"has the same session_id as {other}", "a different session_id"
            yield Finding(what, path, allowed=allowed, remedy="move the copy out of the dataset")


def _levels(dataset: Dataset) -> Iterator[Finding]:
    """Yield the first entry of each journal, in tasks with levels, that does not follow from what stands before it."""
    for path, header in dataset.sessions:
        protocol = dataset.version(header)
        if (task := protocol.task(header.task)).levels is not None:
            tracks = import_module("palpate.experiment.study.levels").Tracks(protocol, task)
            yield from tracks.findings(path, journal.read(path).entries)


def _sites(dataset: Dataset) -> Iterator[Finding]:
    """Yield the first stimulus of each journal that was felt at another site of the body than its protocol has."""
    for path, header in dataset.sessions:
        protocol = dataset.version(header)
        site_of = protocol.kind_table(protocol.task(header.task)).site_of
        # Of a kind that presents nothing at a site, no journal is read for it.
        felt = (one for entry in journal.read(path).entries for one in entry.felt_at) if site_of else ()
        for material, site in felt:
            if site != (wanted := site_of.get(material)):
                what = f"has a stimulus of {material} {f'at {site}' if site else 'without a site'}"
                yield Finding(what, path, allowed=wanted or "no site", remedy="restore the journal from a backup")
                break


def _facts(dataset: Dataset) -> Iterable[Finding]:
    """Return what is wrong with the files of what participants told of themselves; nothing where nothing is asked."""
    if not any(getattr(one, "asked", None) for one in dataset.versions.values()):
        return ()
    facts = import_module("palpate.experiment.study.people.facts")
    known = facts.columns((*dataset.versions.values(), dataset.protocol))
    wrong: Iterable[Finding] = facts.findings(dataset.root, dataset.people, known)
    return wrong


def _check_header(path: Path, header: Header, study: Dataset) -> None:
    """Refuse a journal that is not of this path, this study, and its purpose."""
    participant, task = header.participant, header.task
    if path != (own := storage.journal_path(study.root, participant, task)):
        raise _foreign(path, f"participant {participant}, task {task}", str(own.relative_to(study.root)))
    known = study.tasks.get(participant)
    if known is None:
        raise _foreign(path, f"participant {participant}", f"{min(study.tasks)} to {max(study.tasks)}, as in the plan")
    if task not in known:
        raise _foreign(path, f"task {task}", f"{', '.join(known)}, the tasks of participant {participant}")
    plan, protocol = study.plan, study.version(header)
    expected = {
        "purpose": study.purpose,
        "study": protocol.study.id,
        "protocol_sha256": approval.sha256(protocol),
        "seed": study.seed,
        "task_position": known.index(task) + 1,
        "task_kind": protocol.task(task).kind,
        "design": protocol.task(task).design,
        "block_trials": schedule.block_trials(protocol, task),
        **({"rig_sha256": plan.rig_sha256} if plan else {}),
        **({"session_id": header.rehearsed_id(plan.control)} if plan and plan.label == "REHEARSAL" else {}),
    }
    for name, allowed in expected.items():
        if (got := getattr(header, name)) != allowed:
            raise _foreign(path, f"{name} {got}", f"{allowed}, as in the rest of this dataset")
    seed, presents = study.seed, protocol.materials_of(protocol.task(task))
    if foreign := sorted({one for trial in header.order for one in trial.presented}.difference(presents)):
        raise _foreign(path, f"trials with {', '.join(foreign)}", f"{', '.join(presents)}, which task {task} presents")
    if header.order != schedule.schedule(protocol=protocol, participant=participant, task_id=task, seed=seed):
        raise _foreign(path, "a different order of trials", "the order that follows from the protocol and the seed")
    if study.roster is not None and study.approvals is not None:
        _check_enrolment(path, header, study.roster, study.approvals, protocol)


def _foreign(path: Path, got: str, allowed: str) -> DatasetError:
    what = f"does not belong to this dataset: its header has {got}"
    remedy = "move the journal out of the dataset, or back to where it came from"
    return DatasetError(path, what, remedy, allowed=allowed)


def _check_enrolment(path: Path, header: Header, roster: Roster, known: Approvals, protocol: Protocol) -> None:
    """Refuse a session of somebody who had not enrolled and consented before, or had withdrawn, or without approval."""
    began = datetime.fromisoformat(header.started_utc)
    days = _days(began)
    try:
        then = roster.as_of(header.roster_sha256)
        then.may_run(header.participant, protocol, approved_on=date.min, today=date.max)
        # The day of a consent may have been corrected since; consents to later approvals came after the session.
        count = len(then.consents.get(header.participant, ()))
        consent_on = roster.consents[header.participant][count - 1] if count else None
        rosters.check_consent(header.participant, consent_on, approved_on=_first_day(known), today=days[-1])
        if header.seal_sha256 is not None:
            # The machine's clock may have been set back after the last line of the roster.
            lines = [datetime.fromisoformat(clock.utc(link.t_ns)) for link in then.lines.links[-1:]]
            _check_approval(header, then, then.approvals(known.approved[0]), _days(max([began, *lines])))
    except RosterError as error:
        if error.finding.where == roster.path:
            # The roster was cut; the sessions that began under its last lines are as they were.
            raise
        what = f"the session should not have begun: {error.finding.observation()}"
        raise RosterError.at(replace(error.finding, where=path, what=what)) from error


def _days(moment: datetime) -> tuple[date, ...]:
    """Return the days that it may have been at a moment where a session was run."""
    return tuple(dict.fromkeys((moment + ahead).date() for ahead in (FARTHEST_WEST, timedelta(0), FARTHEST_EAST)))


def _first_day(known: Approvals) -> date:
    return min(one.approved_on for one in known.approved)


def _check_approval(header: Header, roster: Roster, known: Approvals, days: tuple[date, ...]) -> None:
    """Refuse a session that began without the approval that its header names, by the lines of the roster until then."""
    one = known.approved[known.number_of(header.seal_sha256) - 1]
    if (one.seal_sha256, one.protocol_sha256) != (header.seal_sha256, header.protocol_sha256):
        what = f"its seal {str(header.seal_sha256)[:12]} did not belong to any approval then on record"
        raise RosterError(what, remedy="if a seal was changed or replaced, restore it from a backup")
    if all(known.stop(day) for day in days):
        raise RosterError("the approval had been suspended or had ended")
    if all(day < one.from_on or day > one.expires_on for day in days):
        what = f"approval {one.number} was valid from {one.from_on} to {one.expires_on}"
        raise RosterError(f"{what}, but the session began on {header.started_utc[:10]}")
    consented = known.approved[roster.consented.get(header.participant, 1) - 1]
    if header.consent_sha256 not in (None, consented.protocol_sha256):
        raise RosterError("the participant had consented to a different version of the protocol")


def _tables_alone(dataset: Dataset) -> Iterator[Finding]:
    """Yield tables of a session without a journal; those of whose data were erased are refused already."""
    begun = {path.name.removesuffix("journal.jsonl") for path in dataset.begun}
    for path in sorted(dataset.root.glob("sub-*/beh/sub-*_task-*")):
        who, task = path.name.split("_")[:2]
        if f"{who}_{task}_" not in begun and who.removeprefix("sub-") not in dataset.people.erased:
            remedy = "restore the journal under sourcedata from a backup, or move the table out of the dataset"
            yield Finding("this table has no journal", path, remedy=remedy)


def _lost_sessions(dataset: Dataset) -> Iterator[Finding]:
    """Yield participants, or the first task of one, whom a table knows and of whom no journal is there, and those in
    another group than was drawn.
    """
    root, table = dataset.root, dataset.root / "participants.tsv"
    for who in dataset.people.consent_on:
        if (got := dataset.people.groups.get(who, "")) != (drawn := dataset.groups.get(who, "")):
            what = f"participant {who} is in group '{got}', but was allocated to group '{drawn}'"
            yield Finding(what, dataset.people.path, remedy="restore the roster and the protocol from a backup")
    for row in table_rows(table):
        participant, first = row.get("participant_id", "").removeprefix("sub-"), row.get("first_task", "")
        tasks = dataset.tasks.get(participant, ())
        own = {storage.journal_path(root, participant, task): task for task in tasks}
        wanted = {path for path, task in own.items() if task == first} or own.keys()
        erased = any(dataset.people.has_erased(str(path)) for path in wanted)
        if wanted and not erased and dataset.begun.isdisjoint(wanted):
            lost = f"is missing, although {table.name} lists a session of participant {participant}"
            words = f"if there was no such session, {table.name} was edited; delete it, then make it again"
            remedy = build_again(root, words, suffices=False)
            yield Finding(f"{lost}; restore the journal from a backup", min(wanted), remedy=remedy)


def build_again(root: Path, words: str, *, suffices: bool = True) -> Remedy:
    """Return the remedy whose command makes the tables of a dataset."""
    return Remedy(words, ("palpate", "build", str(root)), suffices)


def _forgotten_withdrawals(root: Path, roster: Roster, marked: Iterable[Path]) -> Iterator[Finding]:
    """Yield each withdrawal that is not in the roster, but `marked` in journals or in a file of its own."""
    for path in sorted({*marked, *(root / "sourcedata").glob("sub-*/sub-*_withdrawn.json")}):
        if (participant := path.parent.name.removeprefix("sub-")) not in roster.withdrawn:
            what = f"participant {participant} withdrew according to {path}, but not according to the roster"
            yield Finding(what, roster.path, remedy="restore the roster from a backup")


OF_TABLES = ("edits", "traces")
"""The checks that compare what was made of sound sessions' journals; looked up, for no session brings them along."""

OF_FILES: Mapping[str, Callable[[Sessions], Iterable[Finding]]] = {
    "rigs": lambda sessions: import_module("palpate.experiment.dataset.verify").rig_files(sessions),
    "recordings": lambda sessions: import_module("palpate.experiment.dataset.verify").recordings(sessions),
    "companions": lambda sessions: import_module("palpate.experiment.dataset.verify").companions(sessions),
}
"""The checks of what journals name, `Sessions` alone, which only `palpate verify` runs; one that passes says so."""

CHECKS: Mapping[str, Callable[[Dataset], Iterable[Finding]]] = {
    "anchors": _anchors,
    "erased": _erased,
    "strays": _strays,
    "journals": lambda dataset: dataset.damage,
    "losses": lambda dataset: import_module("palpate.experiment.dataset.outside.losses").losses(dataset.sessions),
    "frames": _frames_alone,
    "copies": _copies,
    "levels": _levels,
    "sites": _sites,
    "tables": _tables_alone,
    "participants": _lost_sessions,
    "withdrawals": lambda dataset: _forgotten_withdrawals(dataset.root, dataset.people, dataset.withdrawals),
    "facts": lambda dataset: _facts(dataset),
    "edits": lambda dataset: import_module("palpate.experiment.dataset.tables").differences(dataset),
    "traces": lambda dataset: import_module("palpate.experiment.dataset.tables").lost_traces(dataset),
    **OF_FILES,
}
"""Every check of a dataset, in the order in which it is run, by the name that its findings have."""
