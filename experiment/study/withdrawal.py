"""Withdrawing a participant from a study, and erasing what it has of them."""

from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.clock import MonotonicClock
from palpate.experiment.errors import DatasetError, PalpateError, RosterError
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Withdrawal
from palpate.experiment.study.enrolment import check_reason, study_begun
from palpate.experiment.study.roster import Erased, Roster


def withdraw(
    protocol_file: Path,
    participant: str,
    reason: str,
    *,
    root: Path | None,
    rebuild: Callable[[Path], object],
    erase: bool = False,
) -> Path:
    """Record that a participant withdrew, and return the roster's file; analysis omits them.

    The roster is written first, then the journals, then the tables (`rebuild`); the same call completes an interrupted
    one. What the participant told of themselves is deleted in any case; `erase` also deletes their data, except for a
    note of the withdrawal. Raises `RosterError` if the participant is not enrolled, has another reason on record, or
    the reason is not one line, names somebody or mentions health, and for an erasure that would take data of another
    person who takes part; `SessionLocked` during a session.
    """
    root = study_begun(protocol_file, root)
    path = storage.roster_path(root)
    Roster.load(path).check_enrolled(participant)
    if erase:
        _check_apart(Roster.load(path), participant)
    with ExitStack() as locked:
        for label in _labels(Roster.load(path), participant) if erase else [participant]:
            locked.enter_context(journal.locked(storage.participant_folder(root, label), label))
        known = Roster.continued(path)
        if known.withdrawn.get(participant) != reason and not (erase and participant in known.withdrawn):
            check_reason(protocol_file, root, reason)
            known.withdraw(participant, reason)
        for told in storage.answers_of(root, participant):
            storage.remove(told)
        if erase:
            _erase(root, known, participant)
        else:
            _mark(root, known, participant, reason)
        if erase or storage.journals(root):
            try:
                rebuild(root)
            except PalpateError as error:
                what = f"the withdrawal of participant {participant} is on record, but the tables were not rebuilt"
                recorded = DatasetError(f"{what}: fix the problem, then run the same command again")
                raise error.followed_by(recorded) from error
    return path


def _check_apart(roster: Roster, participant: str) -> None:
    """Raise `RosterError` where a label has data of somebody who takes part, or that one's label has theirs."""
    pairs = [{label, person} for (label, _), person in roster.took_part.items() if label != person]
    mixed = set[str]().union(*(pair for pair in pairs if participant in pair)) - {participant, *roster.withdrawn}
    if mixed:
        names = ", ".join(sorted(mixed))
        what = f"participants {participant} and {names} have sessions under each other's labels"
        remedy = (
            f"withdraw without --erase, so that the analysis leaves {participant} out; erase the data after {names} "
            "withdraws"
        )
        raise RosterError(what, remedy=remedy)


def count_recorded(protocol_file: Path, participant: str, *, root: Path | None) -> tuple[int, int, int]:
    """Return how many sessions and answers an erasure deletes, and how many of the sessions are another person's.

    Raises `RosterError` and `SessionLocked`.
    """
    root = study_begun(protocol_file, root)
    roster = Roster.load(storage.roster_path(root))
    roster.check_enrolled(participant)
    for label in _labels(roster, participant):
        journal.check_free(storage.participant_folder(root, label), label)
    paths = [path for path in roster.left_of(root, participant) if path.suffix == ".jsonl" and storage.size(path)]
    answers = sum(storage.read_bytes(path).count(b'"kind":"answer"') for path in paths)
    return len(paths), answers, len(_others(root, roster, participant).intersection(paths))


def _labels(roster: Roster, participant: str) -> list[str]:
    """Return the label of a person, and those under which they have sessions."""
    return list(dict.fromkeys([participant, *(label for label, _ in roster.sessions_elsewhere(participant))]))


def _others(root: Path, roster: Roster, label: str) -> set[Path]:
    """Return the journals of other people under a label."""
    whose = roster.took_part.items()
    return {storage.journal_path(root, who, task) for (who, task), person in whose if who == label != person}


def _mark(root: Path, roster: Roster, participant: str, reason: str) -> None:
    """Leave the withdrawal in the participant's journals, or in a file of its own if a journal is another's or none."""
    others = _others(root, roster, participant)
    begun = [
        (path, contents)
        for path in storage.journals(root)
        if path.parent == storage.participant_folder(root, participant)
        if path not in others and (contents := journal.read(path)).lines
    ]
    for path, contents in begun:
        # Opening it brings up a head that a kill left one line behind.
        with closing(journal.Journal(path, MonotonicClock(), contents)) as opened:
            if not isinstance(contents.entries[-1], Withdrawal):
                torn = contents.torn.decode("utf-8", "backslashreplace")
                opened.append(Withdrawal(reason=reason, torn=torn))
    if others or not begun:
        _mark_apart(root, participant, reason)


def _mark_apart(root: Path, participant: str, reason: str) -> None:
    storage.write_json(storage.withdrawal_path(root, participant), {"participant": participant, "reason": reason})


def _erase(root: Path, roster: Roster, participant: str) -> None:
    """Delete what the dataset has of a participant; the roster says so before the first file is gone."""
    folders = {label: storage.participant_folder(root, label) for label in _labels(roster, participant)}
    for folder in folders.values():
        if folder.is_symlink():
            raise DatasetError(folder, "is a link", "replace the link with the folder itself, then try again")
    for label in folders:
        _mark_apart(root, label, roster.withdrawn[label])
    if participant not in roster.erased:
        roster.append(Erased, participant=participant)
    for path in roster.left_of(root, participant):
        storage.remove(path)
    for folder in folders.values():
        storage.sync_folder(folder)
