"""Which of palpate's own files a file is that was given where another was wanted.

`load` looks this up for a file that is refused, so that a rig file in a protocol's place has one line and not one for
each key. In come its path, its document and the model that was wanted; what the commands do, this room may not know.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from palpate.experiment.errors import ProtocolError, Remedy, mismatch
from palpate.experiment.settings.load import Confined

_RIG, _PROTOCOL, _SEAL = "a rig file", "a protocol", "the seal of a protocol"
_MODES = "the modes of a simulated panel"

_KEYS = {
    _RIG: ("rig", "tracker", "actuator", "audio"),
    _PROTOCOL: ("study", "tasks", "ethics"),
    _SEAL: ("protocol_sha256",),
    _MODES: ("suspension", "modes"),
}
"""Keys that only files of one kind have."""


def error(path: Path, model: type[Confined], document: Mapping[str, Any]) -> ProtocolError | None:
    """Return the error of a file of another kind than the model's, None if it is none that palpate has."""
    wanted, got = (tuple(_kinds(keys)) for keys in (model.model_fields, document))
    if len(wanted) != 1 or len(got) != 1 or wanted == got:
        return None
    remedy = Remedy(*_remedy(got[0], str(path)), suffices=False)
    return ProtocolError.at(replace(mismatch("file", None, got[0], wanted[0], remedy), where=path))


def _kinds(keys: Mapping[str, Any]) -> Iterator[str]:
    return (kind for kind, own in _KEYS.items() if any(one in keys for one in own))


def _remedy(kind: str, path: str) -> tuple[str, tuple[str, ...]]:
    if kind == _RIG:
        return "check a rig with {}", ("palpate", "doctor", "--rig", path)
    if kind == _PROTOCOL:
        return "check a protocol with {}", ("palpate", "check", path)
    if kind == _SEAL:
        protocol = path.removesuffix(".seal.toml") + ".toml"
        return "check the protocol and its seal with {}", ("palpate", "check", protocol)
    return "use it with {}", ("palpate", "rehearse", "PROTOCOL", "--panel", path)
