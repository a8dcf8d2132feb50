"""Who may be run today in one of their tasks, and under which approval; what a journal's header then names."""

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.errors import Remedy, RosterError
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.study import approvals, enrolment
from palpate.experiment.study.approvals import Approvals, Approved
from palpate.experiment.study.roster import Roster
from palpate.experiment.study.schedule import Allocation


@dataclass(frozen=True)
class Admission:
    """That a participant may be run: the roster as it is, the approval, and the version to which they consented."""

    roster: Roster
    approved: Approved
    consent_sha256: str | None


def own_journals(root: Path, participant: str, tasks: Iterable[str]) -> dict[str, Path]:
    """Return the journals of a person's sessions, as `Roster.journals_of`."""
    return Roster.load(storage.roster_path(root)).journals_of(root, participant, tasks)


def check_label(roster: Roster, who: str, task: str) -> None:
    """Raise `RosterError` where a participant's session of a task is under another's label, or another's is theirs."""
    if (label := roster.label_of(who, task)) != who:
        person = roster.took_part.get((who, task), who)
        whose = (
            f"participant {person} did the session under label"
            if label is None
            else (f"their own session is under {label}, not")
        )
        what = f"participant {who} has no session of task '{task}' to run: {whose} {who}, according to the roster"
        remedy: Remedy | str = "leave that session as it is, and give another task"
        if label is None:
            reason = "another person took part under this label"
            words = (
                "let them do it under a new label: {}, then run palpate enrol, then palpate incident with "
                "--took-part to move their own sessions to that label"
            )
            remedy = Remedy(words, ("palpate", "withdraw", "PROTOCOL", "-p", who, "--reason", reason), suffices=False)
        raise RosterError(what, remedy=remedy)


def sessions_begun(root: Path, allocation: Allocation, known: Approvals) -> dict[str, int]:
    """Return the number of the approval of each task of which a person's session has begun."""
    paths = own_journals(root, allocation.participant, allocation.tasks)
    read = {task: journal.read_if_begun(path) for task, path in paths.items()}
    return {task: known.number_of(one.header.seal_sha256) for task, one in read.items() if one.lines}


def approval_for(root: Path, allocation: Allocation, task_id: str, known: Approvals, day: date) -> Approved | None:
    """Return the approval for a session of a task on `day`; None if an amendment ended the session that had begun."""
    begun = sessions_begun(root, allocation, known)
    return known.covering(day, visit=max(begun.values(), default=None), session=begun.get(task_id))


def admit(
    root: Path,
    protocol_file: Path,
    protocol: Protocol,
    allocation: Allocation,
    task_id: str,
    given: tuple[str, ...],
    today: date,
) -> Admission:
    """Return under which approval a participant may be run today in a task.

    Raises `RosterError` if the study is suspended or ended, if the approval has expired, if they may not be run or have
    to consent again, or as `check_label`, and `DatasetError` if the protocol or its seal is not the one that covers
    them. `given` are the options that the command of a remedy has beside participant and dataset.
    """
    roster = Roster.load(storage.roster_path(root))
    first = approvals.read_first(root, protocol_file, followed=enrolment.may_follow(root, protocol))
    all_approvals, on = roster.approvals(first), roster.known_day(today)
    who = allocation.participant
    if (stop := all_approvals.stop(on)) is not None:
        raise approvals.stopped_error(stop)
    check_label(roster, who, task_id)
    wanted = approval_for(root, allocation, task_id, all_approvals, on)
    if wanted is None:
        what = f"participant {who} cannot continue task '{task_id}': an amendment ended all sessions in progress"
        later = allocation.tasks[allocation.tasks.index(task_id) + 1 :]
        left = any(approval_for(root, allocation, task, all_approvals, on) for task in later)
        remedy = "leave out --task to run the next task" if left else "this participant has no tasks left"
        raise RosterError(what, remedy=remedy)
    run = ("palpate", "run", "-p", who, *given)
    enrolment.check_version(root, protocol, wanted, run)
    if approvals.seal_sha256(protocol_file) != wanted.seal_sha256:
        raise _other_seal(root, protocol_file, wanted, all_approvals, run)
    if on > wanted.expires_on:
        what = f"approval {wanted.number}, which covers participant {who}, expired on {wanted.expires_on}"
        raise RosterError(what, remedy="ask the board to renew it, or ask how this participant may finish")
    first_day = all_approvals.approved[0].approved_on
    roster.may_run(who, protocol, approved_on=min(first_day, wanted.approved_on), today=today)
    consented = roster.consented.get(who)
    if protocol.consent.required and (consented or 0) < all_approvals.consent_needed(wanted.number):
        given = ("--participant", who, "--consent-on", "DAY", "--dataset", str(root))
        again = Remedy(
            "ask them to read and sign the new consent text, then run {}",
            ("palpate", "consent", str(protocol_file), *given),
            suffices=False,
        )
        what = f"participant {who} consented to an earlier version, but the board requires consent to this one"
        raise RosterError(what, remedy=again)
    consent = all_approvals.approved[consented - 1].protocol_sha256 if consented else None
    return Admission(roster, wanted, consent)


def _other_seal(
    root: Path, protocol_file: Path, wanted: Approved, known: Approvals, run: tuple[str, ...]
) -> RosterError:
    """Return the error of a seal that is not the one that covers a participant: a renewal to record, or an old one."""
    found = approvals.seal_sha256(protocol_file)
    what = f"this protocol's seal does not match approval {wanted.number} in {root}"
    if found in {one.seal_sha256 for one in known.approved}:
        right = str(storage.protocol_path(root, wanted.number))
        remedy = Remedy("use the renewed approval: {}", (*run[:2], right, *run[2:], "--dataset", str(root)))
    else:
        amend = ("palpate", "amend", str(protocol_file), "--dataset", str(root))
        remedy = Remedy("if the board renewed the approval, record that first: {}", amend, suffices=False)
    return RosterError(protocol_file, what, remedy)
