"""The roster: who is enrolled, who has consented, who has withdrawn; a file of chained lines.

Participants are labels: '01', '02', ... in order of enrolment. Beyond the planned number each further one replaces
somebody who withdrew before completing, with the same tasks in the same order.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from datetime import date
from itertools import chain as chained
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal, get_args

from pydantic import Field, TypeAdapter, ValidationError

from palpate.experiment import storage
from palpate.experiment.clock import day, wall_ns
from palpate.experiment.errors import Finding, Remedy, RosterError, other_format
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import chain
from palpate.experiment.records.chain import Chain
from palpate.experiment.records.entries import Entry
from palpate.experiment.settings.characters import quoted
from palpate.experiment.settings.load import VISIBLE, Line
from palpate.experiment.study.approvals import Approvals, Approved, Stopped
from palpate.experiment.study.lines import Eligible, Facts, Incident, Informed, criteria_sha256
from palpate.experiment.study.schedule import labels, stranger

FORMAT: Literal[2] = 2
"""The format of the roster's file. Format 1 has no lines of approvals; a roster begun in it may go on with them."""

Number = Annotated[int, Field(ge=1)]
"""The number of the approval that began the version to which somebody consented; lines of format 1 have none."""


Group = Annotated[str, Field(exclude_if=lambda name: not name)]
"""The group into which somebody was drawn; the lines of a study without groups have none."""


class Enrolled(Entry):
    """A participant took up the next place of the study."""

    kind: Literal["enrolled"] = "enrolled"
    participant: str
    consent_on: date | None
    approval: Number = 1
    group: Group = ""


class First(Entry):
    """The first participant of a study took up their place; its seed was drawn at that moment, as the hash holds."""

    kind: Literal["first"] = "first"
    format: Literal[1, 2] = FORMAT
    participant: str
    consent_on: date | None
    seed_sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    group: Group = ""


class Replacing(Entry):
    """A participant, beyond the planned ones, took up the place of one who withdrew."""

    kind: Literal["replacing"] = "replacing"
    participant: str
    consent_on: date | None
    approval: Number = 1
    takes: str
    group: Group = ""


class Consented(Entry):
    """A participant gave consent who had enrolled without it, or to a later approval than before."""

    kind: Literal["consented"] = "consented"
    participant: str
    consent_on: date
    approval: Number = 1


Reason = Annotated[Line, Field(max_length=200)]
"""One line that names no person and no state of health."""


class Corrected(Entry):
    """The day of a consent on record was wrong; from now on this one holds."""

    kind: Literal["corrected"] = "corrected"
    participant: str
    consent_on: date
    reason: Reason


class Withdrawn(Entry):
    """A participant withdrew, or was withdrawn."""

    kind: Literal["withdrawn"] = "withdrawn"
    participant: str
    reason: Reason


class Erased(Entry):
    """Journals, raw frames and tables of a participant who had withdrawn are deleted from here on."""

    kind: Literal["erased"] = "erased"
    participant: str


class Voices(Entry):
    """A participant agreed that the sound of their answers is kept, or did not; the last such line holds."""

    kind: Literal["voices"] = "voices"
    participant: str
    agreed: bool
    told_on: date


class Sharing(Entry):
    """A participant agreed that their data are shared, or did not; the last such line holds for what is shared next.

    The hash is that of what the protocol shares, as `sharing_sha256` has it: who agreed to else is asked anew.
    """

    kind: Literal["sharing"] = "sharing"
    participant: str
    agreed: bool
    sharing_sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    told_on: date


class Shared(Entry):
    """Data of these participants left the laboratory."""

    kind: Literal["shared"] = "shared"
    participants: Annotated[tuple[str, ...], Field(min_length=1)]
    shared_on: date


class Revealed(Entry):
    """The concealed order of what a participant does was shown; the label need not be enrolled."""

    kind: Literal["revealed"] = "revealed"
    participant: str
    revealed_on: date


AnyEntry = Annotated[
    First
    | Enrolled
    | Replacing
    | Consented
    | Corrected
    | Voices
    | Sharing
    | Shared
    | Withdrawn
    | Erased
    | Revealed
    | Approved
    | Stopped
    | Incident
    | Informed
    | Eligible
    | Facts,
    Field(discriminator="kind"),
]
_ENTRY: TypeAdapter[AnyEntry] = TypeAdapter(AnyEntry)


@dataclass
class Roster:
    """The roster file of a study: one chained line for each event, only ever appended to.

    `consent_on` holds each participant's day of consent, or None without consent, in the order of enrolment;
    `withdrawn` holds the reasons of those who withdrew, `erased` those whose data were deleted, and `revealed` the days
    on which a concealed order was first shown. `voices` tells, of each who was asked, whether the sound of their
    answers may be kept, and `sharing` the hash of what they agreed to share, empty if nothing; `shared` has the days on
    which data of theirs last were. `takes` names, for each who came after the planned ones, the participant whose place
    they took. `seed_sha256` is the hash of the study's seed with its salt, as the first participant's line has it; None
    in a study that began before such lines. `approved` are the approvals after the first, `stopped` what suspended or
    ended them, and `consented` the number of the approval to whose version each participant consented. `consents` has
    the days of all their consents, as corrected. `incidents` are adverse events and deviations, which name nobody.
    `eligible` has the hash of the criteria that each participant was confirmed to meet, `facts` that of the file of
    what they were asked about themselves; `groups` the group of each, where a study has groups. `now_ns` tells the time
    of a new line.
    """

    path: Path
    consent_on: dict[str, date | None] = field(default_factory=dict)
    withdrawn: dict[str, str] = field(default_factory=dict)
    erased: set[str] = field(default_factory=set)
    revealed: dict[str, date] = field(default_factory=dict)
    takes: dict[str, str] = field(default_factory=dict)
    voices: dict[str, bool] = field(default_factory=dict)
    sharing: dict[str, str] = field(default_factory=dict)
    shared: dict[str, date] = field(default_factory=dict)
    approved: list[Approved] = field(default_factory=list)
    stopped: list[Stopped] = field(default_factory=list)
    consented: dict[str, int] = field(default_factory=dict)
    consents: dict[str, list[date]] = field(default_factory=dict)
    incidents: list[Incident] = field(default_factory=list)
    eligible: dict[str, str] = field(default_factory=dict)
    facts: dict[str, str] = field(default_factory=dict)
    groups: dict[str, str] = field(default_factory=dict)
    seed_sha256: str | None = None
    lines: Chain = chain.EMPTY
    now_ns: Callable[[], int] = field(default=wall_ns, repr=False, compare=False)

    @classmethod
    def load(cls, path: Path) -> Roster:
        """Return a roster; without a file nobody is enrolled. Raises `RosterError` for an unreadable or broken one."""
        return cls._replay(path, chain.read(path, RosterError))

    def as_of(self, sha256: str | None) -> Roster:
        """Return the roster as it was when its last line had this hash. Raises `RosterError` if it has no such line."""
        for number, link in enumerate(self.lines.links, start=1):
            if link.sha256 == sha256:
                return self._replay(self.path, Chain(self.lines.links[:number]))
        raise RosterError(
            self.path,
            "is missing a line that a session depends on: the roster was truncated or edited",
            "restore it from a backup",
        )

    @classmethod
    def continued(cls, path: Path) -> Roster:
        """Return a roster as `load`, and write its head, which a kill leaves one line behind: a cut would not show."""
        roster = cls.load(path)
        if roster.lines.links:
            with roster._writing():
                roster = cls.load(path)
                chain.Writer(path, roster.lines.end).close()
        return roster

    def enrol(
        self,
        participant: str,
        consent_on: date | None,
        takes: str | None = None,
        seed_sha256: str | None = None,
        approval: int = 1,
        group: str = "",
    ) -> None:
        """Enrol the next participant, on disk when this returns; `consent_on` is None without consent, which is to the
        version that `approval` began. `group` is theirs, in a study with groups.

        `seed_sha256` is the hash of the seed, for the first line. Raises `RosterError` if the label is not the next
        one, which keeps tasks balanced, or if the place that it `takes` is not free.
        """
        who = {"participant": participant, "consent_on": consent_on, "group": group}
        if seed_sha256 is not None and not self.consent_on:
            self.append(First, **who, seed_sha256=seed_sha256)
        elif takes is None:
            self.append(Enrolled, **who, approval=approval)
        else:
            self.append(Replacing, **who, approval=approval, takes=takes)

    def consent(self, participant: str, consent_on: date, approval: int = 1) -> None:
        """Record a consent to the version that `approval` began.

        Raises `RosterError` if not enrolled, consented to it or a later one already, or withdrawn.
        """
        self.append(Consented, participant=participant, consent_on=consent_on, approval=approval)

    def check_consent(self, participant: str, consent_on: date, approval: int) -> None:
        """Return when a consent can be recorded. Raises as `consent`."""
        Roster.load(self.path)._apply(Consented(participant=participant, consent_on=consent_on, approval=approval))

    def correct(self, participant: str, consent_on: date, reason: str) -> None:
        """Record another day of consent; the old one stays. Raises `RosterError` without one, or for a bad reason."""
        self.append(Corrected, participant=participant, consent_on=consent_on, reason=reason)

    def keep_voices(self, participant: str, agreed: bool, today: date) -> None:
        """Record whether spoken answers may be kept from now on. Raises `RosterError` if not enrolled, or withdrawn."""
        self.append(Voices, participant=participant, agreed=agreed, told_on=today)

    def confirm(self, participant: str, criteria: tuple[str, ...], today: date) -> None:
        """Record that each of these criteria is met. Raises `RosterError` if not enrolled, or withdrawn."""
        sha256 = criteria_sha256(criteria)
        facts = {"participant": participant, "criteria": len(criteria), "criteria_sha256": sha256}
        self.append(Eligible, **facts, confirmed_on=today)

    def is_confirmed(self, participant: str, protocol: Protocol) -> bool:
        """Return whether a participant may take part by the criteria, or nobody has to confirm these."""
        wanted = protocol.eligibility
        return not wanted.confirmed or self.eligible.get(participant) == criteria_sha256(wanted.criteria)

    def share(self, participants: tuple[str, ...], today: date) -> None:
        """Record that data are shared. Raises `RosterError` for somebody who has not agreed, or withdrew."""
        self.append(Shared, participants=participants, shared_on=today)

    def withdraw(self, participant: str, reason: str) -> None:
        """Record a withdrawal, with a reason of one line. Raises `RosterError` for a bad reason or if not active."""
        self.append(Withdrawn, participant=participant, reason=reason)

    @property
    def took_part(self) -> dict[tuple[str, str], str]:
        """Who took part in each session, by label and task, that stands under another's label."""
        told = [one.took_part.people for one in self.incidents if one.took_part is not None]
        return {session: person for own in told for session, person in own.items()}

    def label_of(self, participant: str, task: str) -> str | None:
        """Return the label that a participant's session of a task has, None where their own has another's."""
        own = (one for (one, of), person in self.took_part.items() if (of, person) == (task, participant))
        return next(own, None if (participant, task) in self.took_part else participant)

    def journals_of(self, dataset: Path, participant: str, tasks: Iterable[str]) -> dict[str, Path]:
        """Return the journal of a person's session of each task, whatever its label, as far as `label_of` has one."""
        labels = {task: self.label_of(participant, task) for task in tasks}
        return {task: storage.journal_path(dataset, label, task) for task, label in labels.items() if label is not None}

    def approvals(self, first: Approved) -> Approvals:
        """Return all approvals as these lines have them, with the `first`, which has no line."""
        return Approvals((first, *self.approved), tuple(self.stopped))

    def known_day(self, today: date) -> date:
        """Return `today`, or the day of the last line where that is later: the machine's clock was set back."""
        return max([today, *(day(link.t_ns) for link in self.lines.links[-1:])])

    def may_share(self, participant: str) -> bool:
        """Return whether a participant's data may be shared at all: they agreed last, and take part."""
        return bool(self.sharing.get(participant)) and participant not in self.withdrawn

    def has_erased(self, file: str) -> bool:
        """Return whether a file of the dataset, by its path, was under the label or of a person who was erased."""
        name, label = PurePosixPath(file).name, PurePosixPath(file).parent.name.removeprefix("sub-")
        whose = (one for (of, task), one in self.took_part.items() if name.startswith(f"sub-{of}_task-{task}_"))
        return label in self.erased or any(person in self.erased for person in whose)

    def sessions_elsewhere(self, participant: str) -> list[tuple[str, str]]:
        """Return label and task of each session of a person that stands under another's label."""
        return [of for of, person in self.took_part.items() if person == participant != of[0]]

    def left_of(self, dataset: Path, participant: str) -> list[Path]:
        """Return all that a dataset holds of a person: what is under their label, and their sessions under others."""
        other = (storage.left_of_session(dataset, *of) for of in self.sessions_elsewhere(participant))
        return [*storage.left_of(dataset, participant), *chained.from_iterable(other)]

    def may_run(self, participant: str, protocol: Protocol, *, approved_on: date, today: date) -> None:
        """Return when `participant` may be run in the study of `protocol`.

        Raises `RosterError` if not of this study, not enrolled, withdrawn, or without a consent between approval and
        today.
        """
        if participant not in (*labels(protocol), *self.takes):
            raise stranger(participant, labels(protocol))
        if participant not in self.consent_on:
            raise RosterError(f"participant {participant} is not enrolled in {self.path}", remedy="enrol them first")
        if participant in self.withdrawn:
            raise RosterError(
                f"participant {participant} withdrew ({self.withdrawn[participant]}) and can no longer take part",
                remedy="enroll another participant",
            )
        consent_on = self.consent_on[participant]
        if protocol.consent.required and consent_on is None:
            raise RosterError(
                f"participant {participant} has not consented", remedy="record consent before the session"
            )
        if not self.is_confirmed(participant, protocol):
            what = f"the eligibility of participant {participant} has not been confirmed"
            raise RosterError(what, remedy="palpate run asks about each criterion before the session")
        check_consent(participant, consent_on, approved_on=approved_on, today=today)

    @classmethod
    def _replay(cls, path: Path, lines: Chain) -> Roster:
        """Replay the lines of a roster's file."""
        roster = cls(path, lines=lines)
        for number, link in enumerate(lines.links, start=1):
            if link.entry.get("kind") == "first":
                got = link.entry.get("format")
                known = get_args(First.model_fields["format"].annotation)
                if (other := other_format(path, "roster", got, known, line=number)) is not None:
                    raise other
            try:
                roster._apply(_ENTRY.validate_json(link.json))
            except (ValidationError, RosterError) as error:
                inner = error.finding if isinstance(error, RosterError) else Finding("this is not a roster entry")
                remedy = "restore the roster from a backup (nothing was changed)"
                raise RosterError.at(replace(inner, where=path, line=number, remedy=remedy)) from error
        return roster

    def append(self, kind: type[AnyEntry], /, **facts: object) -> None:
        """Put a line on record, on disk when this returns. Raises `RosterError` if it does not follow those before."""
        try:
            entry = kind.model_validate(facts)
        except ValidationError as error:
            raise RosterError(
                f"got the reason {quoted(str(facts.get('reason')))}",
                remedy="give it again in this form",
                allowed=f"one line of 1 to 200 characters, {VISIBLE}",
            ) from error
        with self._writing():
            latest = Roster.load(self.path)
            latest._apply(entry)
            with closing(chain.Writer(self.path, latest.lines.end)) as opened:
                try:
                    link = opened.next_link(self.now_ns(), entry.model_dump(mode="json"))
                    _ENTRY.validate_json(link.json)
                except ValueError as error:
                    raise RosterError(
                        self.path,
                        f"{quoted(repr(entry))} was not written, because it could not be read back",
                        "correct your input",
                    ) from error
                opened.append(link)
            vars(self).update(vars(Roster.load(self.path)) | {"now_ns": self.now_ns})

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Keep other writers out. Raises `RosterError` if the roster cannot be written."""
        try:
            with storage.locked(self.path.with_name(f".{self.path.name}.lock")):
                yield
        except OSError as error:
            what, remedy = f"cannot write the roster ({error.strerror})", f"{storage.remedy(error)}, then try again"
            raise RosterError(self.path, what, remedy) from error

    def _apply(self, entry: AnyEntry) -> None:
        if isinstance(entry, Approved | Stopped | Incident | Informed | Shared):
            self._apply_to_study(entry)
            return
        participant = entry.participant
        if isinstance(entry, First | Enrolled | Replacing):
            self.check_next(participant)
            if isinstance(entry, First):
                if self.consent_on:
                    raise RosterError(f"participant {participant} is not the first", remedy="enrol them again")
                self.seed_sha256 = entry.seed_sha256
            if isinstance(entry, Replacing):
                if entry.takes not in self.withdrawn or entry.takes in self.takes.values():
                    raise RosterError(
                        f"the place of participant {entry.takes} is not free", remedy=f"enrol {participant} again"
                    )
                self.takes[participant] = entry.takes
            if entry.group:
                self.groups[participant] = entry.group
            self._set_consent(participant, entry.consent_on, 1 if isinstance(entry, First) else entry.approval)
            return
        if isinstance(entry, Revealed):
            self.revealed.setdefault(participant, entry.revealed_on)
            return
        self.check_enrolled(participant)
        if isinstance(entry, Erased):
            if participant not in self.withdrawn:
                raise RosterError(f"participant {participant} has not withdrawn", remedy="withdraw them first")
            if participant in self.erased:
                raise RosterError(
                    f"the data of participant {participant} have already been erased", remedy="there is nothing to do"
                )
            self.erased.add(participant)
            return
        if participant in self.withdrawn:
            on_record = f"give the reason on record: '{self.withdrawn[participant]}'"
            mend = on_record if isinstance(entry, Withdrawn) else "enroll another participant"
            raise RosterError(f"participant {participant} has already withdrawn", remedy=mend)
        self._apply_to_active(entry)

    def _apply_to_active(self, entry: Withdrawn | Voices | Eligible | Facts | Sharing | Consented | Corrected) -> None:
        participant = entry.participant
        match entry:
            case Withdrawn():
                self.withdrawn[participant] = entry.reason
            case Voices():
                self.voices[participant] = entry.agreed
            case Eligible():
                self.eligible[participant] = entry.criteria_sha256
            case Facts():
                self.facts[participant] = entry.file_sha256
            case Sharing():
                self.sharing[participant] = entry.sharing_sha256 if entry.agreed else ""
            case _:
                self._apply_consent(entry, self.consent_on[participant])

    def _apply_to_study(self, entry: Approved | Stopped | Incident | Informed | Shared) -> None:
        if isinstance(entry, Approved | Stopped):
            self.check_decision(entry)
        match entry:
            case Approved():
                self.approved.append(entry)
            case Stopped():
                self.stopped.append(entry)
            case Incident():
                if entry.number != len(self.incidents) + 1:
                    raise RosterError(f"incident {entry.number} is not the next one", remedy="report it again")
                self.incidents.append(entry)
            case Informed():
                known = {one.number: one for one in self.incidents if one.informed_on is None}
                if entry.number not in known:
                    what = f"got incident {entry.number}"
                    raise RosterError(
                        what, allowed="an incident on record of which the board has not yet been informed"
                    )
                told = known[entry.number].model_copy(update={"informed_on": entry.informed_on})
                self.incidents[entry.number - 1] = told
            case Shared():
                for one in entry.participants:
                    if not self.may_share(one):
                        raise RosterError(f"participant {one} has not agreed to sharing", remedy="leave them out")
                    self.shared[one] = entry.shared_on

    def _apply_consent(self, entry: Consented | Corrected, known: date | None) -> None:
        participant = entry.participant
        before = self.consented.get(participant, 0)
        if isinstance(entry, Consented) and known is not None and entry.approval <= before:
            raise RosterError(
                f"participant {participant} already consented on {known}",
                remedy="if the day on record is wrong, add --correct and --reason",
            )
        if isinstance(entry, Corrected) and known is None:
            raise RosterError(
                f"participant {participant} has no consent to correct", remedy="record it without --correct"
            )
        if isinstance(entry, Corrected):
            self.consents[participant].pop()
        self._set_consent(participant, entry.consent_on, before if isinstance(entry, Corrected) else entry.approval)

    def _set_consent(self, participant: str, on: date | None, approval: int) -> None:
        if approval > len(self.approved) + 1:
            raise RosterError(f"got consent under approval {approval}", allowed=f"1 to {len(self.approved) + 1}")
        self.consent_on[participant] = on
        if on is not None:
            self.consented[participant] = approval
            self.consents.setdefault(participant, []).append(on)

    def check_decision(self, entry: Approved | Stopped) -> None:
        """Return when a board's decision can be added to those on record. Raises `RosterError` otherwise."""
        stop = Approvals((), tuple(self.stopped)).stop(entry.from_on)
        if stop is not None and stop.kind == "ended":
            what = f"the board ended this study on {stop.from_on}"
            raise RosterError(what, remedy="start a new study with a new study.id")
        if isinstance(entry, Approved):
            least = max((one.from_on for one in self.approved), default=date.min)
            if entry.number != len(self.approved) + 2 or entry.from_on < least:
                what = f"approval {entry.number} from {entry.from_on} is not the next one"
                raise RosterError(what, allowed=f"number {len(self.approved) + 2}, from {least}")
        elif entry.kind == "lifted" and stop is None:
            what = f"the study is not suspended on {entry.from_on}, so there is nothing to lift"
            raise RosterError(what, remedy="to see decisions on record, run palpate status")
        elif entry.kind == "suspended" and stop is not None:
            raise RosterError(f"the study is already suspended from {stop.from_on}", remedy="there is nothing to do")

    def check_enrolled(self, participant: str) -> None:
        """Return when `participant` is enrolled. Raises `RosterError` otherwise."""
        if participant not in self.consent_on:
            enrolled = list(self.consent_on) or ["nobody yet"]
            known = " to ".join(dict.fromkeys((enrolled[0], enrolled[-1])))
            remedy = f"the next label is {self.next_label()}"
            raise RosterError(f"participant '{participant}' is not enrolled", remedy=remedy, allowed=known)

    def check_next(self, participant: str) -> None:
        """Return when `participant` is the next label. Raises `RosterError` otherwise."""
        if participant in self.consent_on:
            raise RosterError(
                f"participant {participant} is already enrolled", remedy=f"the next label is {self.next_label()}"
            )
        if not re.fullmatch(r"[0-9]{2,}", participant) or participant != self.next_label(len(participant)):
            raise RosterError(f"got the label '{participant}'", allowed=f"{self.next_label()}, the next label in order")

    def next_label(self, width: int = 2) -> str:
        """Return the next label; as wide as those enrolled, or as `width` while nobody is."""
        width = len(next(iter(self.consent_on), "0" * width))
        return f"{len(self.consent_on) + 1:0{width}d}"


def check_consent(participant: str, consent_on: date | None, *, approved_on: date | None, today: date) -> None:
    """Raise `RosterError` for a day of consent in the future or before the approval; None is no approval yet."""
    given = ("--participant", participant, "--consent-on", "DAY", "--correct", "--reason", "REASON")
    words = "give the correct day; to correct a day that is already on record, run {}"
    mend = Remedy(words, ("palpate", "consent", "PROTOCOL", *given), suffices=False)
    if consent_on is not None and consent_on > today:
        raise RosterError(f"participant {participant}", f"got consent on {consent_on}", mend, allowed=f"up to {today}")
    if consent_on is not None and approved_on is not None and consent_on < approved_on:
        raise RosterError(
            f"participant {participant}",
            f"got consent on {consent_on}",
            mend,
            allowed=f"from {approved_on}, the day of approval",
        )
