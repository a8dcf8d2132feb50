"""The canonical form of a protocol, the hash of that form, and the seal that approves it.

The form is RFC 8785 JSON of every field, defaults included, so comments, the order of keys and the way a number is
written do not change it. It has only the keys of the format that the file names: a key added later breaks no seal.

The seal is a record beside the file. It holds the hash and the form, so that a change can name its field. It shows that
the protocol is the approved one, not who approved it. `sealing` writes it.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator
from datetime import date
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args

import rfc8785
from pydantic import Field

from palpate.experiment import storage
from palpate.experiment.errors import Finding, ProtocolError, Remedy, mismatch, other_format
from palpate.experiment.protocol import rules
from palpate.experiment.protocol.models import OLDER, Protocol, older
from palpate.experiment.settings import load
from palpate.experiment.settings.characters import quoted
from palpate.experiment.settings.load import Confined, Line, Rules, Text, written
from palpate.experiment.storage import Place

MOST_FIELDS = 5
"""So many changed fields are named."""

WHOLE, BEFORE = 55, 20
"""Characters of a text that is told whole; and of a longer one, before the place where it was changed."""

Format = Literal[1]
"""Formats of the seal's file."""

FORMAT: Format = 1
"""The one that is written."""


def canonical(protocol: Protocol) -> bytes:
    """Return the RFC 8785 JSON of `protocol`, UTF-8: exactly the keys of its format; dates are ISO 8601 text."""
    document = protocol.model_dump(mode="json")
    if protocol.format in OLDER:
        older().restore(document)
    for *tables, key in load.younger(protocol, protocol.format):
        table: Any = document
        for part in tables:
            table = table[part]
        del table[key]
    return rfc8785.dumps(document)


def sha256(protocol: Protocol) -> str:
    """Return the SHA-256 of the canonical form, 64 hexadecimal digits."""
    return hashlib.sha256(canonical(protocol)).hexdigest()


class Seal(Confined):
    """One approval; `protocol` is the canonical form of what was approved, which names its format."""

    RULES: ClassVar[Rules] = rules.ethics

    format: Format
    protocol_sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$", description="64 hexadecimal digits")]
    approval_number: Line
    board: Text
    approved_on: date
    expires_on: date
    protocol: Text


def seal_path(protocol_path: Path) -> Path:
    """Return where the seal of a protocol file stands: `study.toml` -> `study.seal.toml`."""
    return protocol_path.with_name(f"{protocol_path.stem}.seal.toml")


def verify(protocol_path: Path, protocol: Protocol, today: date) -> Seal:
    """Return the seal under which `protocol` may run `today`. Raises `ProtocolError` if there is none."""
    seal = read(protocol_path)
    problems = changes(protocol_path, protocol, seal)
    if today < seal.approved_on:
        allowed = f"today ({today}) or earlier"
        problems.append(
            mismatch(
                "approved_on", None, str(seal.approved_on), allowed, "wait until that day, or set this computer's clock"
            )
        )
    if today > seal.expires_on:
        allowed, remedy = (
            f"{today} (today) or later: the approval has expired",
            "have the approval renewed, then seal the protocol again",
        )
        problems.append(mismatch("expires_on", None, str(seal.expires_on), allowed, remedy))
    refuse(seal_path(protocol_path), problems)
    return seal


def dataset_seal(protocol_path: Path, protocol: Protocol) -> Seal:
    """Return the seal of a dataset's `protocol`, expired or not. Raises `ProtocolError` if it is gone or changed."""
    if not (path := seal_path(protocol_path)).exists():
        remedy = "restore the seal from a backup: a new seal would be a different approval"
        refuse(path, [mismatch("seal", None, "no seal", "the seal under which the study began", remedy)])
    seal = read(protocol_path)
    refuse(seal_path(protocol_path), changes(protocol_path, protocol, seal))
    return seal


def read(protocol_path: Path) -> Seal:
    """Return the seal beside a protocol file. Raises `ProtocolError` if there is none, or if it cannot be read."""
    path = seal_path(protocol_path)
    if not path.exists():
        restore = "if it had a seal, restore it from a backup: a new seal would be a different approval"
        remedy = seal_again(protocol_path, f"{restore}; otherwise, have the protocol approved, then seal it")
        refuse(path, [mismatch("seal", None, "no seal", "a sealed protocol", remedy)])
    document, text = load.parsed(path)
    again = seal_again(protocol_path, "to use it, seal the protocol again", "--replace")
    if (other := other_format(path, "seal", document.get("format"), get_args(Format), mend=again)) is not None:
        raise other
    seal = load.checked(path, Seal, document, text)
    own = hashlib.sha256(seal.protocol.encode()).hexdigest()
    if own != seal.protocol_sha256:
        allowed = f"{own[:12]}..., the hash of the protocol text in the seal: the seal was edited"
        got, put_back = f"{seal.protocol_sha256[:12]}...", "restore the seal as `palpate seal` wrote it"
        refuse(path, [mismatch("protocol_sha256", None, got, allowed, put_back)])
    return seal


def seal_again(protocol_path: Path, words: str, *options: str) -> Remedy:
    """Return the remedy whose command seals a protocol, once the board has approved it."""
    given = ("--approval-number", "NUMBER", "--approved-on", "DAY", "--expires-on", "DAY", *options)
    return Remedy(words, ("palpate", "seal", str(protocol_path), *given))


def changes(protocol_path: Path, protocol: Protocol, seal: Seal) -> list[Finding]:
    problems = contradictions(protocol, seal)
    if seal.protocol_sha256 != (found := sha256(protocol)):
        allowed = f"the hash of {protocol_path.name} ({found[:12]}...): the protocol was changed after it was approved"
        remedy = "undo the change, or have it approved and seal the protocol again"
        problems.append(mismatch("protocol_sha256", None, f"{seal.protocol_sha256[:12]}...", allowed, remedy))
        changed, more = differences(protocol, seal.protocol)
        problems += [mismatch(field, None, now, f"{approved}, as approved") for field, now, approved in changed]
        problems += [mismatch("...", None, f"{more} more changes", "none")] if more else []
    return problems


def differences(protocol: Protocol, approved: str) -> tuple[list[tuple[str, str, str]], int]:
    """Return the first few fields that differ from the form in the seal, now and as approved, and how many more do."""
    forms = approved, canonical(protocol)
    sealed, found = (dict(leaves(storage.json_of(form))) for form in forms)
    differing = [path for path in {**sealed, **found} if sealed.get(path, ...) != found.get(path, ...)]
    few = [(written(path), *_parted(found.get(path, ...), sealed.get(path, ...))) for path in differing[:MOST_FIELDS]]
    return few, len(differing) - len(few)


def leaves(value: object, at: Place = ()) -> Iterator[tuple[Place, object]]:
    """Yield every value that holds no others, an empty list or table included, with its path."""
    held: Iterable[tuple[str | int, object]] = ()
    if isinstance(value, dict):
        held = value.items()
    elif isinstance(value, list):
        held = enumerate(value)
    else:
        yield at, value
        return
    if not value:
        yield at, value
    for part, inner in held:
        yield from leaves(inner, (*at, part))


def _parted(found: object, sealed: object) -> tuple[str, str]:
    """Return two values as they are told: long texts from a few words before they part on."""
    if isinstance(found, str) and isinstance(sealed, str) and max(len(found), len(sealed)) > WHOLE:
        pairs = zip(found, sealed, strict=False)
        same = next((i for i, (one, other) in enumerate(pairs) if one != other), min(len(found), len(sealed)))
        if (cut := same - BEFORE) > 0:
            cut = found.find(" ", cut, same) + 1 or cut
            found, sealed = f"...{found[cut:]}", f"...{sealed[cut:]}"
    return _value_text(found), _value_text(sealed)


def _value_text(value: object) -> str:
    if value is ...:
        return "nothing"
    return quoted(value) if isinstance(value, str) else json.dumps(value)


def refuse(path: Path, problems: list[Finding]) -> None:
    if problems:
        raise ProtocolError.in_file(path, problems)


def contradictions(protocol: Protocol, seal: Seal) -> list[Finding]:
    return [
        mismatch(name, None, f"'{sealed}'", f"'{stated}', as in the protocol's ethics block", "correct one of them")
        for name in ("approval_number", "board", "approved_on", "expires_on")
        if (stated := getattr(protocol.ethics, name)) and stated != (sealed := getattr(seal, name))
    ]
