"""Anchors: what a dataset held at one moment, for a register outside the reach of those who can write to the dataset.

An anchor has the number of lines and the last hash of every journal and of the roster. A later dataset begins with the
same lines. A register has one anchor a line, with its signature if any. The dataset's `LOG` has every anchor too, so
that an anchor's number in a lab book is enough to check it.
"""

import hashlib
import os
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import rfc8785
from pydantic import Field, ValidationError

from palpate.experiment import storage
from palpate.experiment.errors import DatasetError, Finding
from palpate.experiment.records import chain
from palpate.experiment.records.entries import Purpose, Record, Utc
from palpate.experiment.study.roster import Roster

LOG = Path("sourcedata") / "anchors.log"
"""Every anchor of a dataset, inside it."""

NAMESPACE = "palpate"
"""A signature made for another purpose counts for nothing here."""

DIGITS = 16
"""Hexadecimal digits of an anchor's number, as it stands in a lab book; registers have whole hashes."""

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class Prefix(Record):
    """How many lines a file inside the dataset had, and the SHA-256 of the last."""

    file: Annotated[str, Field(pattern=r"^sourcedata/(sub-[0-9A-Za-z]+/)?[0-9A-Za-z_-]+\.jsonl$")]
    lines: Annotated[int, Field(ge=1)]
    sha256: Sha256

    def begins(self, hashes: Sequence[str]) -> bool:
        """Return whether a file with these `line_hashes` still begins with the lines that it had."""
        return len(hashes) >= self.lines and hashes[self.lines - 1] == self.sha256


class Anchor(Record):
    """What a dataset held at one moment; `seal_sha256` is that of its seal's file, None before the first session."""

    anchored_utc: Utc
    study: Annotated[str, Field(pattern=r"^[a-z][a-z0-9]{0,31}$")]
    purpose: Purpose
    protocol_sha256: Sha256
    seal_sha256: Sha256 | None
    prefixes: tuple[Prefix, ...]

    @property
    def canonical(self) -> bytes:
        """RFC 8785 JSON: what is hashed and signed."""
        return rfc8785.dumps(self.model_dump(mode="json"))

    @property
    def number(self) -> str:
        """The first digits of its SHA-256, which stand for all of it in a lab book."""
        return hashlib.sha256(self.canonical).hexdigest()[:DIGITS]

    @property
    def line(self) -> str:
        """What is written into a lab book."""
        number = "-".join(self.number[place : place + 4] for place in range(0, DIGITS, 4))
        return f"{self.anchored_utc[:10]} {self.study} {self.purpose} {number}"


class Kept(Record):
    """A line of a register."""

    anchor: Anchor
    signature: str | None = None


@dataclass(frozen=True)
class Evidence:
    """Anchors of the dataset in one place; `guard` is what a forger would have had to do besides, if anything."""

    place: str
    anchors: tuple[Anchor, ...]
    guard: str = ""


def enter(anchor: Anchor, root: Path, to: Path, key: Path | None) -> str:
    """Add an anchor of `root` to a register, signed if there is an SSH key, and return a sentence about it.

    Raises `DatasetError` if the register is inside of the dataset or unwritable, signing fails, and as `check_state`.
    """
    if to.resolve().is_relative_to(root.resolve()):
        raise DatasetError(to, "is inside the dataset", "choose another place", allowed="a place outside the dataset")
    check_state(root, to, (anchor.study, anchor.purpose))
    kept = Kept(anchor=anchor, signature=_signature(anchor, key) if key else None)
    begun = not to.exists()
    if not begun and storage.size(to) and not read(to)[0]:
        raise DatasetError(to, "is not a register: it has no anchors", "give one", allowed="a register or a new file")
    append(to, kept)
    return f"Anchored in {to}{', signed' if key else ''}." + (" This register is a new file." if begun else "")


def check_state(root: Path, register: Path, of: tuple[str, Purpose]) -> None:
    """Raise `DatasetError` if the register has `root`, of a study and purpose, in a state with other lines."""
    if not register.exists():
        return
    roster = Roster.load(storage.roster_path(root))
    anchors = [one.anchor for one in read(register)[0] if (one.anchor.study, one.anchor.purpose) == of]
    known = [(one, prefix) for one in anchors for prefix in one.prefixes if not roster.has_erased(prefix.file)]
    hashes = {name: line_hashes(root / name) for name in {prefix.file for _, prefix in known}}
    others = [(anchor, prefix) for anchor, prefix in known if not prefix.begins(hashes[prefix.file])]
    if not others or len(others) == len(known):
        return
    anchor, prefix = others[-1]
    raise DatasetError(
        register,
        f"records a different state of this dataset: the first {prefix.lines} lines of {prefix.file} differ from "
        f"those anchored on {anchor.anchored_utc[:10]}; a backup was restored, or there are two copies",
        "continue with the state that was anchored last; if that state is lost, give a new register",
    )


def read(path: Path) -> tuple[tuple[Kept, ...], tuple[int, ...]]:
    """Return a register's anchors, oldest first, and the numbers of lines without one. Raises `DatasetError`."""
    try:
        lines, torn = chain.split(storage.read_bytes(path))
    except OSError as error:
        raise DatasetError(path, f"cannot read the register ({error.strerror})", "give its path") from error
    kept: list[Kept] = []
    broken: list[int] = []
    for number, line in enumerate([*lines, torn], start=1):
        try:
            kept.append(Kept.model_validate_json(line))
        except ValidationError:
            broken += [number] if number <= len(lines) else []
    return tuple(kept), tuple(broken)


def line_hashes(path: Path) -> tuple[str, ...]:
    """Return the SHA-256 of each whole line of a journal or a roster; none where there is no file."""
    try:
        data = storage.read_bytes(path)
    except FileNotFoundError:
        return ()
    except OSError as error:
        raise DatasetError(path, f"cannot be read ({error.strerror})", "restore it") from error
    return tuple(hashlib.sha256(line).hexdigest() for line in chain.split(data)[0])


def log_findings(root: Path, roster: Roster, of: tuple[str, Purpose] | None = None) -> Iterator[Finding]:
    """Yield what a dataset's log of anchors shows: each file that was not erased and is not as it was anchored.

    `of` are the study and purpose of the dataset, if they are known: an anchor of others shows that the log is not its
    own.
    """
    log = root / LOG
    kept, broken = read(log) if log.exists() else ((), ())
    if broken and not kept:
        yield Finding("has no readable anchors", log, remedy="restore it from a backup")
    if of and (foreign := foreign_anchors(log, kept, of)):
        yield foreign
    anchors = tuple(one.anchor for one in kept if of in (None, (one.anchor.study, one.anchor.purpose)))
    names = {prefix.file for one in anchors for prefix in one.prefixes}
    files = {name: line_hashes(root / name) for name in names}
    yield from contradictions(root, roster, files, [Evidence(str(log), anchors)])


def foreign_anchors(log: Path, kept: Sequence[Kept], *known: tuple[str, Purpose]) -> Finding | None:
    """Return the finding of a dataset's log that has anchors of studies and purposes which are not its `known` ones."""
    if others := sorted({(one.anchor.study, one.anchor.purpose) for one in kept}.difference(known)):
        named = " and ".join(f"the {purpose} {study}" for study, purpose in others)
        return Finding(f"has anchors for another dataset: {named}", log, remedy="restore it from a backup")
    return None


@dataclass(frozen=True)
class Anchored:
    """That a file had so many lines on a day, by one anchor; `same` tells whether it still begins with them."""

    lines: int
    day: str
    place: str
    same: bool


def anchors_of_file(name: str, hashes: Sequence[str], evidence: Sequence[Evidence]) -> list[Anchored]:
    """Return what is anchored of a file, the fewest lines first."""
    return sorted(
        (
            Anchored(prefix.lines, anchor.anchored_utc[:10], place.place, prefix.begins(hashes))
            for place in evidence
            for anchor in place.anchors
            for prefix in anchor.prefixes
            if prefix.file == name
        ),
        key=lambda anchored: (anchored.lines, anchored.day),
    )


def contradictions(
    root: Path, roster: Roster | None, files: Mapping[str, Sequence[str]], evidence: Sequence[Evidence]
) -> Iterator[Finding]:
    """Yield each file of a dataset that is not as it was anchored, and was not erased.

    `files` have the hashes of the lines of those that are there. `roster` is None where it cannot be read.
    """
    named = {prefix.file for place in evidence for anchor in place.anchors for prefix in anchor.prefixes}
    for name in sorted({*files, *named}):
        hashes = files.get(name, ())
        anchored = () if roster and roster.has_erased(name) else anchors_of_file(name, hashes, evidence)
        broken = [one for one in anchored if not one.same]
        if not broken:
            continue
        first, last = broken[0], broken[-1]
        it = "the roster first, which shows whether the file was erased" if _may_be_erased(root, roster, name) else "it"
        if first.lines > len(hashes):
            gone = last.lines - len(hashes)
            are, by = "is" if gone == 1 else "are", f"the anchor of {last.day} in {last.place}"
            text = (
                f"is an older state, or a continuation of one: {gone} of the {last.lines} lines {are} missing that "
                f"were in {by}; compare both, because each may have lines that the other lacks, and continue with the "
                "newer one"
                if hashes
                else f"is missing: it had {last.lines} {'line' if last.lines == 1 else 'lines'} in {by}; restore {it}"
            )
        else:
            kept = max((one.lines for one in anchored if one.same and one.lines < first.lines), default=0)
            where = (
                f"line {first.lines}" if first.lines == kept + 1 else (f"one of the lines {kept + 1} to {first.lines}")
            )
            text = f"{where} differs from the anchor of {first.day} in {first.place}: the file was rewritten"
        yield Finding(text, root / name)


def _may_be_erased(root: Path, roster: Roster | None, name: str) -> bool:
    """Return whether a file that is missing was erased for all that is known: the roster is lost, or has lost lines."""
    participant = Path(name).parent.name.removeprefix("sub-")
    if roster is None:
        return root / name != storage.roster_path(root)
    return participant not in roster.withdrawn and storage.withdrawal_path(root, participant).exists()


def _signature(anchor: Anchor, key: Path) -> str:
    if not key.is_file():
        raise DatasetError(key, "is not a file", "give its path", allowed="a private SSH key")
    done = ssh_keygen(("sign", "-f", str(key)), anchor)
    if done.returncode:
        why = " ".join(done.stderr.decode("utf-8", "replace").split())
        raise DatasetError(key, f"the anchor was not signed ({why})", "give a private SSH key that you can use")
    return done.stdout.decode("ascii")


def ssh_keygen(asked: Sequence[str], anchor: Anchor) -> subprocess.CompletedProcess[bytes]:
    """Run ssh-keygen on an anchor's canonical form. Raises `DatasetError` if it is not installed."""
    command = ("ssh-keygen", "-Y", *asked, "-n", NAMESPACE)
    try:
        return subprocess.run(command, input=anchor.canonical, capture_output=True, check=False)  # noqa: S603
    except FileNotFoundError as error:
        raise DatasetError(
            "ssh-keygen is not installed", remedy="install the OpenSSH client, then try again"
        ) from error


def append(path: Path, kept: Kept) -> None:
    """Add a line, on disk when this returns. A line that was never finished stays a line of its own."""
    try:
        with path.open("a+b") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(size - 1, 0))
            torn = size and file.read(1) != b"\n"
            file.write((b"\n" if torn else b"") + kept.model_dump_json().encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
        if not size:
            storage.sync_folder(path.parent)
    except OSError as error:
        why = error.strerror or error
        raise DatasetError(path, f"the anchor cannot be written ({why})", "make it writable") from error
