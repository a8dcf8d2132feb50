"""One form of a protocol, whatever its file looks like, and the hash of that form.

The form is RFC 8785 JSON of every field, defaults included: what is approved is what is carried out, whether a
value was written down or left to its default. So comments, the order of keys, inline tables and the way a number
is written (`20`, `20.0`, `2e1`) do not change it.
"""

from __future__ import annotations

import hashlib

import rfc8785

from experiment.protocol.models import Protocol


def canonical(protocol: Protocol) -> bytes:
    """RFC 8785 JSON of `protocol`, UTF-8; dates as ISO 8601 text."""
    return rfc8785.dumps(protocol.model_dump(mode="json"))


def sha256(protocol: Protocol) -> str:
    """SHA-256 of the canonical form, 64 hexadecimal digits."""
    return hashlib.sha256(canonical(protocol)).hexdigest()
