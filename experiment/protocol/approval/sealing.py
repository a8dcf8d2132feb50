"""Writing the seal of a protocol, and the state of its approval in words; no session needs either."""

import re
from datetime import date
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.errors import Finding, PalpateError, Remedy, mismatch
from palpate.experiment.protocol.approval import (
    FORMAT,
    Seal,
    canonical,
    changes,
    contradictions,
    differences,
    leaves,
    read,
    refuse,
    seal_path,
    sha256,
)
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.settings import load
from palpate.experiment.settings.characters import quoted
from palpate.experiment.settings.load import written

UNFILLED = "TO BE FILLED IN"
"""Stands in a text that a new protocol has until its laboratory writes its own; see `new`."""


def unfilled(protocol: Protocol) -> tuple[str, ...]:
    """Return the fields that still say `UNFILLED`, as users read their paths."""
    texts = leaves(protocol.model_dump(mode="json"))
    return tuple(written(path) for path, value in texts if isinstance(value, str) and UNFILLED in value)


def unfilled_findings(protocol_path: Path, protocol: Protocol) -> list[Finding]:
    """Return a finding for each field that is still to be filled in."""
    got, write_it = f"'{UNFILLED}'", _page_of(protocol_path, "fill it in, then have the board read the page")
    return [mismatch(name, None, got, "your own text", write_it) for name in unfilled(protocol)]


def refuse_unfilled(protocol_path: Path, protocol: Protocol) -> None:
    """Raise `ProtocolError` while a field is still to be filled in: nobody can approve that, or consent to it."""
    refuse(protocol_path, unfilled_findings(protocol_path, protocol))


def write(
    protocol_path: Path,
    protocol: Protocol,
    *,
    approval_number: str,
    board: str,
    approved_on: date,
    expires_on: date,
    page_sha256: str | None = None,
    replace: bool = False,
) -> Seal:
    """Record the approval of `protocol`, as loaded from `protocol_path`, beside it.

    `page_sha256` are the first digits of the hash on the board's copy of the page. `replace` lets the seal replace
    another; datasets begun under that one keep their copy. Raises `ProtocolError` if the page was of another version, a
    field is empty, contradicts the ethics block or is still to be filled in, or a seal exists.
    """
    path = seal_path(protocol_path)
    if page_sha256 is not None:
        refuse(protocol_path, _of_another_page(protocol_path, protocol, page_sha256))
    refuse_unfilled(protocol_path, protocol)
    stated = {
        "format": FORMAT,
        "protocol_sha256": sha256(protocol),
        "approval_number": approval_number,
        "board": board,
        "approved_on": approved_on,
        "expires_on": expires_on,
        "protocol": canonical(protocol).decode(),
    }
    seal = load.checked(path, Seal, stated)
    refuse(path, contradictions(protocol, seal))
    if path.exists() and not replace:
        same = read(protocol_path).protocol_sha256 == seal.protocol_sha256
        there = "this version of the protocol is already sealed" if same else "a seal for a different version exists"
        remedy = "replace it (--replace), or move it away"
        refuse(path, [mismatch("seal", None, "an existing seal", f"no seal: {there}", remedy)])
    _write(path, seal)
    return seal


def unsealed(protocol_file: Path, today: date) -> str:
    """Return what to tell of a protocol under which somebody was enrolled without a seal that is valid `today`."""
    if not seal_path(protocol_file).exists():
        return (
            "the protocol is not sealed, and no session can begin. Until somebody consents, changes to the file also "
            "update the dataset's copy"
        )
    ended = read(protocol_file).expires_on
    return f"the approval ended on {ended}. No session can begin until it is renewed" if ended < today else ""


def replaced(protocol_path: Path, protocol: Protocol) -> str:
    """Return in a sentence what another seal of `protocol` would take the place of."""
    try:
        seal = read(protocol_path)
    except PalpateError:
        return "This replaces an unreadable seal."
    version = "this version" if seal.protocol_sha256 == sha256(protocol) else "a different version of the protocol"
    number = quoted(seal.approval_number)
    return f"This replaces the seal of {version}: approval {number}, from {seal.approved_on} to {seal.expires_on}."


def state(protocol_path: Path, protocol: Protocol, today: date) -> tuple[str, Seal | None]:
    """Return the state of approval `today` in a sentence, and the seal. Raises `ProtocolError` if it is unreadable."""
    if not seal_path(protocol_path).exists():
        return "NOT SEALED: there is no approval next to this protocol file.", None
    seal = read(protocol_path)
    if changes(protocol_path, protocol, seal):
        version = f"{seal.protocol_sha256[:12]}..."
        changed, more = differences(protocol, seal.protocol)
        named = [f"{field} is {now}, but {approved} was approved" for field, now, approved in changed]
        fields = "; ".join([*named, *([f"{more} more changes"] if more else [])])
        told = (
            f"CHANGED SINCE IT WAS SEALED: the seal is for a different version, {version}. `palpate run` refuses this "
            "version."
        )
        return f"{told} Differences from the approved version: {fields}." if fields else told, seal
    if today < seal.approved_on:
        return f"SEALED FOR LATER: the approval of this version begins on {seal.approved_on}.", seal
    if today > seal.expires_on:
        return f"SEALED, BUT EXPIRED: the approval of this version has ended (today is {today}).", seal
    return "SEALED: this version is approved. Compare the seal with the board's letter.", seal


def _page_of(protocol_path: Path, words: str) -> Remedy:
    return Remedy(words, ("palpate", "check", str(protocol_path)), suffices=False)


def _of_another_page(protocol_path: Path, protocol: Protocol, digits: str) -> list[Finding]:
    found = sha256(protocol)
    if not re.fullmatch("[0-9a-f]{8,64}", digits.lower()):
        allowed = f"8 to 64 hexadecimal digits (there are {len(digits)})"
        return [mismatch("--sha256", None, quoted(digits), allowed, "type the first digits from the page again")]
    if found.startswith(digits.lower()):
        return []
    words = "the board read the page of a different version; have the board read the page of this version"
    allowed = f"the first 8 or more digits of {found}"
    return [mismatch("--sha256", None, quoted(digits), allowed, _page_of(protocol_path, words))]


def _write(path: Path, seal: Seal) -> None:
    stated = [f"{name} = {load.toml(value)}\n" for name, value in seal]
    storage.write(path, "".join(stated).encode())
