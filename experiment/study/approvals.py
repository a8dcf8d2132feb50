"""Which approval a session is under: the first, its renewals and amendments, and what suspends or ends them.

Approval 1 is `sourcedata/protocol.toml` with its seal. Each later one has a line in the roster, and its protocol and
seal beside the first, as `protocol-2.toml`. One with the protocol of an earlier approval is a renewal, which extends
that version for those it covers, even where a later one has begun. Any other is an amendment, which begins a version.
Days are those of the lab.
"""

import hashlib
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from palpate.experiment import storage
from palpate.experiment.errors import Remedy, RosterError
from palpate.experiment.protocol import approval, files
from palpate.experiment.records import chain
from palpate.experiment.records.entries import Entry
from palpate.experiment.settings.load import Line

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]

InProgress = Literal["old", "session", "new"]
"""Under which version somebody goes on who had begun: the old one until all tasks are done, until the session that is
under way is complete, or not at all, so that a session under way is not continued."""


class Approved(Entry):
    """An approval after the first: valid from `from_on` to `expires_on`; what the board decided of those who had begun.

    `reconsent`: whoever goes on under this approval, or a later one, consents to it first.
    """

    kind: Literal["approved"] = "approved"
    number: Annotated[int, Field(ge=1)]
    protocol_sha256: Sha256
    seal_sha256: Sha256 | None
    approved_on: date
    expires_on: date
    from_on: date
    in_progress: InProgress
    reconsent: bool


class Stopped(Entry):
    """The board suspended every approval of the study from a day on, lifted the suspension, or ended the study."""

    kind: Literal["suspended", "lifted", "ended"]
    from_on: date
    reason: Annotated[Line, Field(max_length=200)]


@dataclass(frozen=True)
class Approvals:
    """All approvals of a study, the first one first, and the lines that stopped them, in the order of the roster."""

    approved: tuple[Approved, ...]
    stops: tuple[Stopped, ...] = ()

    def started_by(self, day: date) -> tuple[Approved, ...]:
        """Return the approvals that began by `day`; the first one always counts."""
        return (*self.approved[:1], *(one for one in self.approved[1:] if one.from_on <= day))

    def stop(self, day: date) -> Stopped | None:
        """Return the suspension or the end because of which nothing runs on `day`."""
        begun = sorted((one for one in self.stops if one.from_on <= day), key=lambda one: one.from_on)
        ended = [one for one in begun if one.kind == "ended"]
        return next(iter(ended or [one for one in begun[-1:] if one.kind == "suspended"]), None)

    def version(self, number: int) -> int:
        """Return the number of the approval that began the version of approval `number`."""
        return self.version_of(self.approved[number - 1].protocol_sha256) or number

    def version_of(self, protocol_sha256: str) -> int | None:
        """Return the number of the approval that began the version with this hash; None for another version."""
        return next((one.number for one in self.approved if one.protocol_sha256 == protocol_sha256), None)

    def version_on(self, day: date) -> int:
        """Return the number of the approval that began the version which those who begin on `day` are under."""
        return max(self.version(one.number) for one in self.started_by(day))

    def covering(self, day: date, *, visit: int | None, session: int | None = None) -> Approved | None:
        """Return the approval for a session on `day`; None if the session is not continued under any.

        `visit` is the number of the approval of the participant's latest session, None before the first. `session` is
        that of this session, None if it has not begun.
        """
        began = session or visit
        if visit is not None and visit > 1:
            # What a session was under has begun, even if the machine's clock was set back since.
            day = max(day, self.approved[visit - 1].from_on)
        known = self.started_by(day)
        version = self.version(began) if began else self.version_on(day)
        for one in known:
            if began is None or one.number <= began or self.version(one.number) != one.number:
                continue
            if session is not None and one.in_progress == "new":
                return None
            if session is None and one.in_progress != "old":
                version = one.number
        return [one for one in known if self.version(one.number) == version][-1]

    def consent_needed(self, number: int) -> int:
        """Return the lowest number of an approval to which somebody must have consented who runs under `number`."""
        version = self.version(number)
        return max((one.number for one in self.approved[:version] if one.reconsent), default=1)

    def number_of(self, seal_sha256: str | None) -> int:
        """Return the number of the approval with this seal; the first for None, as journals of format 9 name none."""
        return next((one.number for one in self.approved if one.seal_sha256 == seal_sha256 is not None), 1)


def read_first(root: Path, file: Path | None = None, *, followed: bool = False) -> Approved:
    """Return approval 1 of a dataset, by its kept seal; by that beside `file` while neither session nor amendment is.

    Without a seal nothing runs under it. `followed`: as it is once the dataset follows `file`. Raises `ProtocolError`
    for a protocol or seal that cannot be read.
    """
    kept = storage.protocol_path(root)
    own = approval.sha256(files.load(file if followed and file else kept))
    places = (kept, file) if has_begun(root) else (file, kept)
    sealed = next((one for one in places if one is not None and approval.seal_path(one).exists()), None)
    seal = approval.read(sealed) if sealed is not None else None
    if sealed is None or seal is None or seal.protocol_sha256 != own:
        days, sha256 = (date.max, date.min), None
    else:
        days, sha256 = (seal.approved_on, seal.expires_on), seal_sha256(sealed)
    return Approved(
        number=1,
        protocol_sha256=own,
        seal_sha256=sha256,
        approved_on=days[0],
        expires_on=days[1],
        from_on=days[0],
        in_progress="old",
        reconsent=False,
    )


def keep_first(root: Path, file: Path) -> None:
    """Keep the seal beside `file` as that of approval 1, unless a session or an amendment fixed it."""
    if not has_begun(root) and approval.seal_path(file).exists():
        kept = approval.seal_path(storage.protocol_path(root))
        storage.write_bytes(kept, storage.read_bytes(approval.seal_path(file)))


def has_begun(root: Path) -> bool:
    """Return whether a session has begun, or an amendment was recorded: what was approved first stays as it is."""
    return is_amended(root) or any(storage.size(path) for path in storage.journals(root))


def is_amended(root: Path) -> bool:
    """Return whether the roster has an approval after the first; copies that an interrupted command left are none."""
    links = chain.read(storage.roster_path(root), RosterError).links
    return any(link.entry.get("kind") == "approved" for link in links)


def seal_sha256(protocol_file: Path) -> str:
    """Return the hash of the file of a protocol's seal, whatever its line ends. Raises `OSError` without one."""
    return seal_forms(protocol_file)[0]


def seal_forms(protocol_file: Path) -> tuple[str, str]:
    """Return that hash, and the one with CR LF line ends: palpate 0.2.0 anchored a file as it was.

    Raises `OSError` without a seal.
    """
    data = storage.read_bytes(approval.seal_path(protocol_file)).replace(b"\r\n", b"\n")
    return hashlib.sha256(data).hexdigest(), hashlib.sha256(data.replace(b"\n", b"\r\n")).hexdigest()


def stopped_error(stop: Stopped) -> RosterError:
    """Return the error of a study whose approval is suspended or has ended."""
    what = f"the board {'ended' if stop.kind == 'ended' else 'suspended'} this study on {stop.from_on} ({stop.reason})"
    lift = ("palpate", "amend", "PROTOCOL", "--lifted-on", "DAY", "--reason", "REASON")
    words = "run no sessions until the board lifts the suspension, then record that: {}"
    remedy = "no further sessions are possible" if stop.kind == "ended" else Remedy(words, lift, suffices=False)
    return RosterError(what, remedy=remedy)
