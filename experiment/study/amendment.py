"""Record what a board decided while a study runs: an amendment, a renewal, a suspension, or the end of the study.

The protocol and its seal are copied into the dataset first and the roster's line comes last, so that an interrupted
command is run again.
"""

from datetime import date
from pathlib import Path
from typing import Literal

from palpate.experiment import storage
from palpate.experiment.clock import day, wall_ns
from palpate.experiment.errors import DatasetError, ProtocolError, RosterError
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.progress import progress
from palpate.experiment.study import approvals, enrolment
from palpate.experiment.study.approvals import Approvals, Approved, InProgress, Stopped
from palpate.experiment.study.roster import Roster
from palpate.experiment.study.schedule import allocated, labels


def known_approvals(protocol_file: Path, root: Path | None) -> tuple[Path, Roster, Approvals]:
    """Return a study's dataset, its roster and its approvals. Raises `RosterError` if no dataset has begun."""
    root = enrolment.study_begun(protocol_file, root)
    roster = Roster.load(storage.roster_path(root))
    return root, roster, roster.approvals(approvals.read_first(root))


def latest(root: Path, known: Approvals) -> Protocol:
    """Return the latest version of a dataset's protocol."""
    return files.load(storage.protocol_path(root, known.version_on(date.max)))


def plan_approval(
    protocol_file: Path,
    *,
    root: Path | None,
    from_on: date | None = None,
    in_progress: InProgress | None = None,
    reconsent: bool | None = None,
) -> Approved:
    """Return the approval that `amend` would record, by the seal beside a protocol; nothing is written.

    `from_on` None is the first day on which it can begin. A renewal has neither `in_progress` nor `reconsent`, an
    amendment has both. Raises `ProtocolError` without a fitting seal, `RosterError` for one that is on record or for
    a day that cannot be, and `DatasetError` for a protocol that would change who does what.
    """
    protocol = files.load(protocol_file)
    root, roster, known = known_approvals(protocol_file, root)
    seal = approval.read(protocol_file)
    approval.refuse(approval.seal_path(protocol_file), approval.changes(protocol_file, protocol, seal))
    sha256, last = approvals.seal_sha256(protocol_file), known.approved[-1]
    for one in known.approved:
        if one.seal_sha256 == sha256:
            what = f"its seal is already on record as approval {one.number}"
            sealed = approval.seal_again(protocol_file, "seal the board's new approval first: {}", "--replace")
            raise RosterError(protocol_file, what, sealed)
    renewal = known.version_of(approval.sha256(protocol)) is not None
    if renewal and last.seal_sha256 is None:
        raise RosterError("no session has begun, so this seal need not be recorded", remedy="begin the first session")
    today = roster.known_day(day(wall_ns()))
    if seal.expires_on < today:
        what = f"the approval in its seal ended on {seal.expires_on}, before today ({today})"
        words = "seal the board's renewed approval: {}"
        raise RosterError(protocol_file, what, approval.seal_again(protocol_file, words, "--replace"))
    begins = from_on or max(today, seal.approved_on, last.from_on if last.number > 1 else today)
    if not max(today, seal.approved_on) <= begins <= seal.expires_on:
        what, allowed = (
            f"got {begins} as the first day of the amendment",
            f"{max(today, seal.approved_on)} to {seal.expires_on}",
        )
        raise RosterError(what, allowed=allowed, remedy="earlier sessions belong to the earlier approval")
    if renewal and (in_progress or reconsent is not None):
        what = "got --in-progress or --reconsent for a renewal, which does not change the protocol"
        raise RosterError(what, remedy="leave them out")
    if not renewal:
        _refuse_other_study(root, protocol_file, roster, latest(root, known), protocol)
    planned = Approved(
        number=last.number + 1,
        protocol_sha256=approval.sha256(protocol),
        seal_sha256=sha256,
        approved_on=seal.approved_on,
        expires_on=seal.expires_on,
        from_on=begins,
        in_progress=in_progress or "old",
        reconsent=bool(reconsent),
    )
    roster.check_decision(planned)
    return planned


def record(protocol_file: Path, planned: Approved, *, root: Path | None) -> Path:
    """Record a planned approval, and return its copy of the protocol in the dataset. Raises as `Roster.approve`."""
    root = enrolment.study_begun(protocol_file, root)
    kept = storage.protocol_path(root, planned.number)
    files.keep(protocol_file, kept)
    storage.write_bytes(approval.seal_path(kept), storage.read_bytes(approval.seal_path(protocol_file)))
    if (
        approvals.seal_sha256(kept) != planned.seal_sha256
        or approval.sha256(files.load(kept)) != planned.protocol_sha256
    ):
        raise ProtocolError(protocol_file, "was changed meanwhile", "run the same command again")
    Roster.continued(storage.roster_path(root)).append(Approved, **planned.model_dump(exclude={"kind"}))
    return kept


def stop(
    protocol_file: Path,
    kind: Literal["suspended", "lifted", "ended"],
    from_on: date,
    reason: str,
    *,
    root: Path | None,
) -> Path:
    """Record that the board suspended the study, lifted that, or ended it, and return the roster's file.

    Raises `RosterError` for a reason that names somebody, and for a change that cannot follow what is on record.
    """
    root = enrolment.study_begun(protocol_file, root)
    enrolment.check_reason(protocol_file, root, reason)
    roster = Roster.continued(storage.roster_path(root))
    roster.append(Stopped, kind=kind, from_on=from_on, reason=reason)
    return roster.path


def lifted_after(roster_file: Path, day: date) -> date | None:
    """Return the first day after `day` on which a suspension on record is lifted; None without any."""
    lifts = (one.from_on for one in Roster.load(roster_file).stopped if one.kind == "lifted" and one.from_on > day)
    return min(lifts, default=None)


def to_reconsent(root: Path, known: Approvals, roster: Roster, today: date) -> tuple[str, ...]:
    """Return who has to consent again before their next session on `today`."""
    if not any(one.reconsent for one in known.approved):
        return ()
    plan = {one.participant: one for one in allocated(latest(root, known), 0, roster.takes)}
    return tuple(
        who
        for who, number in roster.consented.items()
        if who not in roster.withdrawn and number < _needed_number(root, known, roster, plan[who].tasks, who, today)
    )


def _needed_number(root: Path, known: Approvals, roster: Roster, tasks: tuple[str, ...], who: str, today: date) -> int:
    """Return the lowest number of an approval to which a participant must have consented; 0 where nothing is left."""
    read = [journal.read_if_begun(path) for path in roster.journals_of(root, who, tasks).values()]
    begun = [known.number_of(one.header.seal_sha256) for one in read if one.lines]
    if len(begun) == len(tasks) and all(progress(one.entries).complete for one in read):
        return 0
    covering = known.covering(today, visit=max(begun, default=None))
    return known.consent_needed(covering.number) if covering else 0


def _refuse_other_study(root: Path, protocol_file: Path, roster: Roster, old: Protocol, new: Protocol) -> None:
    """Refuse a version that is another study, or would change a label or who does what in which order."""
    told = [
        name
        for name, was, now in (
            ("study.id", old.study.id, new.study.id),
            ("ids, kinds and designs of tasks", _shape(old), _shape(new)),
            ("ids of materials", [one.id for one in old.materials], [one.id for one in new.materials]),
            ("materials of a task", _materials_of_tasks(old), _materials_of_tasks(new)),
            ("ids of groups", _groups(old), _groups(new)),
            ("number of digits in labels", len(labels(old)[0]), len(labels(new)[0])),
        )
        if was != now
    ]
    if told:
        what = f"the versions differ in: {', '.join(told)}. existing labels, orders or tables could not be continued"
        raise DatasetError(protocol_file, what, "give this version a new study.id, and start a new dataset for it")
    seed = enrolment.seed_of(root)
    tasks = [{one.participant: one.tasks for one in allocated(version, seed, roster.takes)} for version in (old, new)]
    for who in roster.consent_on:
        if tasks[0].get(who) != tasks[1].get(who):
            what = f"participant {who} would get different tasks or a different order from those drawn at enrollment"
            raise DatasetError(protocol_file, what, "leave task_order and the participants of tasks as they were")


def _groups(protocol: Protocol) -> list[str]:
    return [one.id for one in getattr(protocol, "groups", ())]


def _shape(protocol: Protocol) -> list[tuple[str, str, str]]:
    return [(task.id, task.kind, task.design) for task in protocol.tasks]


def _materials_of_tasks(protocol: Protocol) -> list[tuple[str, ...]]:
    return [tuple(protocol.materials_of(task)) for task in protocol.tasks]
