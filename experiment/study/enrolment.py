"""What the first enrolment settles for a study, and the consent of its participants; `people.enrolling` enrols them.

The first enrolment begins the dataset, with one protocol and one seed. The seed decides who does what, so it is drawn
only then, into a file that only its owner reads. Its hash, salted with 128 bits because a seed has only 31, stands in
the roster's first line, which is chained and anchored. If the file is lost, seed and purpose are restored from a
journal's header; without the salt the hash proves nothing.
"""

import hashlib
import secrets
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import date
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from palpate.experiment import storage
from palpate.experiment.clock import day, wall_ns
from palpate.experiment.errors import DatasetError, Remedy, RosterError
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import chain, journal
from palpate.experiment.records.entries import Purpose, Record
from palpate.experiment.study import approvals, people
from palpate.experiment.study.approvals import Approved
from palpate.experiment.study.roster import Roster, check_consent
from palpate.experiment.study.schedule import labels

LOCK = ".study.lock"


def default_root(protocol: Protocol, *, pilot: bool = False) -> Path:
    """Return where the dataset of a study, or of its pilot, stands unless another folder is named."""
    return Path("participants") / f"{protocol.study.id}{'-pilot' if pilot else ''}"


def seed_of(root: Path) -> int:
    """Return the seed of the dataset's draws.

    Raises `DatasetError` if it is missing, broken or not the one hashed in the roster; `RosterError` for a broken
    roster.
    """
    settled, known = read_settled(root), Roster.load(storage.roster_path(root))
    if settled.salt and known.consent_on and known.seed_sha256 is None:
        what = "has no hash of the seed in the first participant's line: the roster was truncated or edited"
        raise DatasetError(known.path, what, "restore it from a backup")
    unlike = known.seed_sha256 != settled.sha256 if settled.salt else not storage.journals(root)
    if known.seed_sha256 is not None and unlike:
        raise DatasetError(
            storage.seed_path(root),
            "is not the seed that was drawn before the first participant enrolled: the roster has the hash of a "
            "different seed",
            "restore the file from a backup",
        )
    return settled.seed


def seed_is_proven(root: Path) -> bool:
    """Return whether a seed that `seed_of` returns is shown by its hash: it has its salt, and the roster the hash."""
    return read_settled(root).salt is not None and Roster.load(storage.roster_path(root)).seed_sha256 is not None


def purpose_of(root: Path) -> Purpose:
    """Return what the sessions of this dataset are for: STUDY or PILOT. Raises `DatasetError` as `seed_of`."""
    return read_settled(root).purpose


class Settled(Record):
    """What `sourcedata/seed.json` holds."""

    format: storage.DatasetFormat
    seed: int
    purpose: Literal["STUDY", "PILOT"]
    salt: Annotated[str, Field(pattern="^[0-9a-f]{32}$")] | None = None

    @property
    def sha256(self) -> str:
        """The hash of the seed with its salt, 64 hexadecimal digits."""
        return hashlib.sha256(f"{self.salt}:{self.seed}".encode()).hexdigest()


def read_settled(root: Path) -> Settled:
    """Return what the dataset settled as it began. Raises `DatasetError` if it cannot be read."""
    file = storage.seed_path(root)
    storage.refuse_other_format(root)
    try:
        return Settled.model_validate_json(storage.read_bytes(file))
    except (OSError, ValidationError) as error:
        content = f'{{"format": {storage.DATASET_FORMAT}, "seed": ..., "purpose": "..."}}'
        anew = [f"write {content} with the values from line 1 of {path}" for path in storage.journals(root)[:1]]
        remedy = ", or ".join(["restore the file from a backup", *anew])
        raise DatasetError(file, "the seed and purpose of the study cannot be read", remedy) from error


def approved_on(root: Path, protocol_file: Path) -> date | None:
    """Return the first day of valid consent, from the seal, None without. Raises `ProtocolError` if it is broken."""
    later = (storage.protocol_path(root, 2),) if approvals.is_amended(root) else ()
    own = () if may_follow(root, files.load(protocol_file)) else (storage.protocol_path(root), *later)
    for one in (*own, protocol_file):
        if approval.seal_path(one).exists():
            return approval.read(one).approved_on
    return None


def check_version(root: Path, protocol: Protocol, wanted: Approved, command: tuple[str, ...]) -> None:
    """Raise `DatasetError` unless `protocol` is the `wanted` approval's version; `command` lacks its file."""
    if approval.sha256(protocol) != wanted.protocol_sha256:
        right = str(storage.protocol_path(root, wanted.number))
        program, name, *given = command
        raise DatasetError(
            root,
            f"got protocol version {approval.sha256(protocol)[:12]}, which approval {wanted.number} does not cover",
            Remedy("use the approved version: {}", (program, name, right, *given, "--dataset", str(root))),
            allowed=f"version {wanted.protocol_sha256[:12]}",
        )


def consent(
    protocol_file: Path, participant: str, consent_on: date, *, root: Path | None, correction: str | None = None
) -> Path:
    """Record the consent of an enrolled participant to the version of a protocol, and return the roster's file.

    `correction` states why the day replaces the one on record. Raises `RosterError` if the participant is not enrolled,
    has withdrawn or consented already, or the day or the reason is not allowed, and `DatasetError` for a version that
    is not on record.
    """
    root = study_begun(protocol_file, root)
    path = storage.roster_path(root)
    known, protocol = Roster.continued(path), files.load(protocol_file)
    check_known(root, protocol_file, protocol)
    number, since = 1, approved_on(root, protocol_file)
    if known.approved:
        all_approvals = known.approvals(approvals.read_first(root))
        given = all_approvals.version_of(approval.sha256(protocol)) or 1
        number = known.consented.get(participant, 1) if correction is not None else given
        since = all_approvals.approved[number - 1].approved_on if number > 1 else since
    check_consent(participant, consent_on, approved_on=since, today=day(wall_ns()))
    if correction is None:
        known.check_consent(participant, consent_on, number)
        with storage.locked(root / "sourcedata" / LOCK):
            _follow(root, protocol_file, protocol)
            known.consent(participant, consent_on, number)
    else:
        check_reason(protocol_file, root, correction)
        known.correct(participant, consent_on, correction)
    return path


def voices(protocol_file: Path, participant: str, agreed: bool, *, root: Path | None) -> Path:
    """Record whether a participant's spoken answers may be kept, delete them if not, and return the roster's file.

    Raises `RosterError` if the protocol keeps none or the participant is not active, `SessionLocked` during a session.
    """
    if not files.load(protocol_file).consent.voice_recordings:
        what, remedy = "got consent.voice_recordings = false", "leave this out: this study stores no sound"
        raise RosterError(protocol_file, what, remedy, allowed="true")
    root = study_begun(protocol_file, root)
    path = storage.roster_path(root)
    known = Roster.continued(path)
    known.check_enrolled(participant)
    with journal.locked(storage.participant_folder(root, participant), participant):
        known.keep_voices(participant, agreed, day(wall_ns()))
        kept = storage.voices_folder(root, participant)
        if not agreed and kept.exists():
            storage.remove(kept)
    return path


def check_reason(protocol_file: Path, root: Path, reason: str) -> None:
    """Raise `RosterError` for a reason that is not one line, names somebody of the study or mentions health."""
    protocol = files.load(protocol_file)
    people.check_reason(reason, (person.name for person in people.known(protocol, root).values()))


def study_begun(protocol_file: Path, root: Path | None) -> Path:
    """Return the folder of a study's dataset; `root` as for `enrol`. Raises `RosterError` if it was not begun."""
    root = root or default_root(files.load(protocol_file))
    refuse_rehearsal(root)
    roster = storage.roster_path(root)
    begun = (storage.protocol_path(root), storage.seed_path(root), roster, chain.head_path(roster))
    if not any(path.exists() for path in begun):
        first = Remedy("give its folder with --dataset, or start one: {}", ("palpate", "enrol", str(protocol_file)))
        raise RosterError(f"the folder {root} has no dataset of this study", remedy=first)
    return root


def refuse_rehearsal(root: Path) -> None:
    """Raise `DatasetError` if the participants of a dataset are simulated."""
    if storage.plan_path(root).exists():
        raise DatasetError(
            root,
            "this is a practice or rehearsal dataset with simulated participants: nobody enrolls, "
            "consents or withdraws",
            Remedy(
                "give the folder of a study with --dataset, delete this one if it is not needed, or try these "
                "commands in a pilot, whose data are not study data",
                ("palpate", "enrol", "PROTOCOL", "--participant", "01", "--pilot"),
                suffices=False,
            ),
        )


@contextmanager
def settling(
    root: Path, protocol_file: Path, protocol: Protocol, seed: int | None, purpose: Purpose | None
) -> Iterator[None]:
    """Save protocol, seed and purpose at first, the protocol last; later ones match, as `seed_for`, or are followed."""
    kept = storage.protocol_path(root)
    if not kept.exists() and any(
        _of_something_else(path.relative_to(root), protocol.companions) for path in root.rglob("*")
    ):
        raise DatasetError(root, "this folder contains something else", "choose another folder with --dataset")
    with storage.locked(root / "sourcedata" / LOCK):
        if not kept.exists():
            storage.people_folder(root)
            drawn = secrets.randbelow(2**31) if seed is None else seed
            settled_as = {"format": storage.DATASET_FORMAT, "seed": drawn, "purpose": purpose or "STUDY"}
            storage.write_json(storage.seed_path(root), settled_as | {"salt": secrets.token_hex(16)})
            storage.owners_alone(storage.seed_path(root))
            files.keep(protocol_file, kept)
        seed_for(root, protocol_file, protocol, seed, purpose)
        _follow(root, protocol_file, protocol)
        yield


def seed_for(root: Path, protocol_file: Path, protocol: Protocol, seed: int | None, purpose: Purpose | None) -> int:
    """Return the seed of a dataset that has begun; nothing is written.

    Raises `DatasetError` for another version, seed or purpose, None being any, and as `seed_of`.
    """
    check_known(root, protocol_file, protocol)
    drawn = seed_of(root)
    if purpose not in (None, begun_as := purpose_of(root)):
        what = f"this dataset was started as a {begun_as}, not as a {purpose}"
        raise DatasetError(root, what, "give a different folder with --dataset; for a pilot, add --pilot")
    if seed not in (None, drawn):
        raise DatasetError(root, f"the study's seed is not {seed}", "leave out --seed")
    return drawn


def _follow(root: Path, protocol_file: Path, protocol: Protocol) -> None:
    check_known(root, protocol_file, protocol)
    if may_follow(root, protocol):
        kept = storage.protocol_path(root)
        files.keep(protocol_file, kept)
        # Last: whatever is refused leaves it there, and one of another version counts as none.
        approval.seal_path(kept).unlink(missing_ok=True)


def check_known(root: Path, protocol_file: Path, protocol: Protocol) -> None:
    """Raise `DatasetError` for a version that a dataset which has begun neither has nor may follow."""
    if storage.protocol_path(root).exists() and not (_is_version(root, protocol) or may_follow(root, protocol)):
        raise _other_version(root, protocol_file)


def may_follow(root: Path, protocol: Protocol) -> bool:
    """Return whether a dataset follows this changed protocol, as no consent, fact or session fixes its own."""
    kept, known = storage.protocol_path(root), Roster.load(storage.roster_path(root))
    if not kept.exists() or _is_version(root, protocol):
        return False
    same = files.load(kept).study.id == protocol.study.id and {*known.consent_on} <= {*labels(protocol)}
    fixed = approvals.has_begun(root) or any(known.consent_on.values()) or known.facts or known.groups
    return same and not fixed


def check_on_record(root: Path, protocol_file: Path, protocol: Protocol) -> None:
    """Raise `DatasetError` for a protocol that is none of the dataset's versions."""
    if not _is_version(root, protocol):
        raise _other_version(root, protocol_file)


def _other_version(root: Path, protocol_file: Path) -> DatasetError:
    known = Roster.load(storage.roster_path(root)).approvals(approvals.read_first(root))
    own = storage.protocol_path(root, known.version_on(date.max))
    words = (
        "if the board approved this version for the current study, seal it, then run {}; if not, use the study's "
        f"version ({own}), or give this version a new study.id"
    )
    amend = ("palpate", "amend", str(protocol_file), "--dataset", str(root))
    remedy = Remedy(words, amend, suffices=False)
    return DatasetError(root, "the study began with a different version of the protocol", remedy)


def _is_version(root: Path, protocol: Protocol) -> bool:
    """Return whether a protocol is that of one of the dataset's approvals."""
    kept = storage.protocol_path(root)
    known = [one.protocol_sha256 for one in Roster.load(storage.roster_path(root)).approved]
    return approval.sha256(protocol) in known or approval.sha256(protocol) == approval.sha256(files.load(kept))


def _of_something_else(path: Path, companions: Iterable[str]) -> bool:
    """Return whether a path is none that a refused or killed command leaves before the study begins."""
    begun = {f"sourcedata/{name}" for name in companions}
    begun |= {"sourcedata", "sourcedata/seed.json", f"sourcedata/{LOCK}", "sourcedata/.roster.jsonl.lock"}
    temporary = path.parent.as_posix() in (".", "sourcedata") and storage.TEMPORARY.fullmatch(path.name)
    return not temporary and path.as_posix() not in begun
