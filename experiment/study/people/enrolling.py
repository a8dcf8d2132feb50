"""Enrol participants, and record whether their data may be shared."""

from datetime import date
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.clock import day, wall_ns
from palpate.experiment.errors import DatasetError, RosterError
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Purpose
from palpate.experiment.records.progress import progress
from palpate.experiment.study import approvals
from palpate.experiment.study.enrolment import (
    approved_on,
    check_known,
    check_on_record,
    check_version,
    default_root,
    read_settled,
    refuse_rehearsal,
    settling,
    study_begun,
)
from palpate.experiment.study.lines import sharing_sha256
from palpate.experiment.study.roster import Roster, Sharing, check_consent
from palpate.experiment.study.schedule import allocated, find_allocation, labels, stranger


def free_place(root: Path, protocol: Protocol, roster: Roster) -> str | None:
    """Return who withdrew first, by label, before completing, with a place that nobody took; None if nobody did."""
    for one in allocated(protocol, 0, roster.takes):
        if one.participant in roster.withdrawn and one.participant not in roster.takes.values():
            paths = roster.journals_of(root, one.participant, one.tasks).values()
            begun = [entries for path in paths if (entries := journal.read_if_begun(path).entries)]
            if sum(progress(entries).complete for entries in begun) < len(one.tasks):
                return one.participant
    return None


def enrol(
    protocol_file: Path,
    participant: str,
    consent_on: date | None,
    *,
    root: Path | None,
    seed: int | None,
    pilot: bool = False,
) -> Path:
    """Enrol the next participant, and return the roster's file; the first enrolment begins the dataset and sets its
    seed.

    Beyond the planned number a participant replaces one who withdrew early. `root` None is `participants/STUDY`, or
    `STUDY-pilot` with `pilot`; `seed` None is the set seed or a new one. Raises `RosterError` for a label that is not
    the next or a day without possible consent, `ProtocolError` if the protocol changed since its seal, and
    `DatasetError` if the folder belongs to something else.
    """
    protocol = files.load(protocol_file)
    purpose: Purpose | None = "PILOT" if pilot else "STUDY" if root is None else None
    root = root or default_root(protocol, pilot=pilot)
    refuse_rehearsal(root)
    if approval.seal_path(protocol_file).exists():
        approval.dataset_seal(protocol_file, protocol)
    check_known(root, protocol_file, protocol)
    check_consent(participant, consent_on, approved_on=approved_on(root, protocol_file), today=day(wall_ns()))
    path = storage.roster_path(root)
    known = Roster.continued(path)
    takes = None if participant in labels(protocol) else free_place(root, protocol, known)
    if participant not in labels(protocol) and takes is None:
        raise stranger(participant, labels(protocol))
    if not path.exists() and any((root / "sourcedata").glob("sub-*")):
        raise DatasetError(root, "contains participants but no roster", f"restore {path} and its head from a backup")
    known.check_next(participant)
    check_current(root, protocol, known, ("palpate", "enrol", "--participant", participant))
    with settling(root, protocol_file, protocol, seed, purpose):
        approvals.keep_first(root, protocol_file)
        begun = read_settled(root)
        all_approvals = known.approvals(approvals.read_first(root))
        number = all_approvals.version_on(consent_on) if consent_on else 1
        places = known.takes | ({participant: takes} if takes else {})
        drawn = find_allocation(allocated(protocol, begun.seed, places), participant)
        known.enrol(participant, consent_on, takes, begun.salt and begun.sha256, number, drawn.group)
    return path


def check_current(root: Path, protocol: Protocol, known: Roster, command: tuple[str, ...]) -> None:
    """Refuse to enrol under a superseded version, or while the approval is suspended or ended."""
    if not known.approved and not known.stopped:
        return
    today = known.known_day(day(wall_ns()))
    all_approvals = known.approvals(approvals.read_first(root))
    if (stop := all_approvals.stop(today)) is not None:
        raise approvals.stopped_error(stop)
    if known.approved:
        check_version(root, protocol, all_approvals.approved[all_approvals.version_on(today) - 1], command)


def sharing(protocol_file: Path, participant: str, agreed: bool, *, root: Path | None) -> date | None:
    """Record whether a participant's data may be shared; return the day on which they last were, None if never.

    Raises `RosterError` if the protocol shares none, or the participant is not active, and `DatasetError` for a version
    that is not on record.
    """
    protocol = files.load(protocol_file)
    if protocol.sharing is None:
        raise RosterError(protocol_file, "has no [sharing] table", "leave this out: this study shares no data")
    root = study_begun(protocol_file, root)
    check_on_record(root, protocol_file, protocol)
    known = Roster.continued(storage.roster_path(root))
    known.check_enrolled(participant)
    facts = {"participant": participant, "agreed": agreed, "sharing_sha256": sharing_sha256(protocol)}
    known.append(Sharing, **facts, told_on=day(wall_ns()))
    return known.shared.get(participant)
