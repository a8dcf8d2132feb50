"""Protocol files: their model, reading one, and finding those that come with palpate."""

import hashlib
import zlib
from importlib import import_module
from pathlib import Path
from typing import Any

from pydantic import Field, create_model

from palpate.experiment import storage
from palpate.experiment.errors import PalpateError, ProtocolError, mismatch
from palpate.experiment.protocol import designs, kinds
from palpate.experiment.protocol.designs import design_of
from palpate.experiment.protocol.kinds import kind_of
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.settings.characters import quoted
from palpate.experiment.settings.load import read

PNG = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"
"""How every PNG file begins and ends (ISO/IEC 15948)."""

LARGEST = 2**26
"""No file beside a protocol's is larger, bytes: minutes of any recording."""

PACKAGE = Path(__file__).parent.parent


def _tables() -> dict[str, Any]:
    """Return the field of each table that a kind or a design has."""
    named = {name: kind_of(name) for name in kinds.NAMES} | {name: design_of(name) for name in designs.NAMES}
    return {
        name: (own.table | None, Field(None, json_schema_extra={"since": own.since} if own.since else None))
        for name, own in named.items()
        if own.table is not None
    }


def _docstring() -> str:
    """Return what a protocol is, with what each table of `_tables` is for."""
    return (
        (Protocol.__doc__ or "").rstrip()
        + "".join(f"\n        {name}: what trials of `{name}` need, in a study that has them." for name in _tables())
        + "\n        asked: what participants are asked outside the trials."
        + "\n        factors: how stimuli differ (crossed)."
        + "\n        groups: groups to which participants are randomly assigned."
    )


_LATER: dict[str, Any] = {
    "asked": (import_module(f"{__package__}.asked").Asked | None, Field(None, json_schema_extra={"since": 7})),
    "factors": (import_module(f"{__package__}.designs.factors").Factors, Field((), json_schema_extra={"since": 7})),
    "groups": (import_module(f"{__package__}.designs.groups").Groups, Field((), json_schema_extra={"since": 7})),
}

ProtocolFile = create_model(
    "ProtocolFile", __base__=Protocol, __module__=__name__, __doc__=_docstring(), **_tables(), **_LATER
)
"""A whole study with the tables of every kind and design, of which a file has those of its own."""


def load(path: Path) -> Protocol:
    """Return the protocol at `path`. Raises `ProtocolError` with all its problems, or its first syntax error."""
    protocol = read(path, ProtocolFile)
    protocol._folder = path.resolve().parent
    return protocol


def companion(protocol: Protocol, name: str) -> bytes:
    """Return a file that stands beside a protocol's. Raises `ProtocolError` for one that is gone, or is another."""
    path, sha256 = protocol.folder / name, protocol.companions[name]
    try:
        content = storage.read_bytes(path, LARGEST)
    except OSError as error:
        problem = mismatch("file", None, f"an unreadable file ({error.strerror})", "a file next to the protocol")
        raise ProtocolError.in_file(path, [problem]) from error
    if (found := hashlib.sha256(content).hexdigest()) != sha256:
        allowed = f"{sha256}, as in the protocol"
        raise ProtocolError.in_file(path, [mismatch("sha256", None, found, allowed, "restore the file")])
    if path.suffix == ".png" and not _is_whole_png(content):
        raise ProtocolError.in_file(
            path, [mismatch("file", None, "an incomplete or different file", "a whole PNG picture")]
        )
    return content


def _is_whole_png(content: bytes) -> bool:
    """Return whether a file is a PNG picture of which each chunk has its checksum (ISO/IEC 15948, 5.3)."""
    at = len(PNG[0])
    while at < len(content):
        checksum = at + 8 + int.from_bytes(content[at : at + 4])
        if zlib.crc32(content[at + 4 : checksum]) != int.from_bytes(content[checksum : checksum + 4]):
            return False
        at = checksum + 4
    return content.startswith(PNG[0]) and content.endswith(PNG[1]) and at == len(content)


def companions(protocol: Protocol) -> dict[str, bytes]:
    """Return the files that stand beside a protocol's, by name. Raises as `companion`."""
    return {name: companion(protocol, name) for name in protocol.companions}


def pictures(protocol: Protocol) -> dict[str, bytes]:
    """Return the pictures of the instructions, by name. Raises as `companion`."""
    return {one.file: companion(protocol, one.file) for task in protocol.tasks for one in task.pictures or ()}


def keep(file: Path, kept: Path) -> None:
    """Copy a protocol's file with those beside it, which come first.

    Raises as `load` and `companion`, and `ProtocolError` where another file of such a name is kept: of an earlier
    version, whose trials presented it.
    """
    protocol = load(file)
    copies = {kept.with_name(name): content for name, content in companions(protocol).items()}
    for copy, content in copies.items():
        if copy.exists() and storage.read_bytes(copy, LARGEST) != content:
            allowed = f"a different name, because {copy} already exists with different content"
            problem = mismatch(
                "file", None, copy.name, allowed, "rename it in the protocol too, and seal the protocol again"
            )
            raise ProtocolError.in_file(file, [problem])
    for copy, content in copies.items():
        storage.write_bytes(copy, content)
    storage.write_bytes(kept, storage.read_bytes(file))


def shipped(name: str) -> Path:
    """Return the file `name` of protocols/ in working folder, checkout or package. Raises `PalpateError` for none."""
    for folder in (Path("protocols"), PACKAGE.parent / "protocols", PACKAGE / "shipped"):
        if (folder / name).is_file():
            return folder / name
    raise PalpateError(
        f"protocols/{name}", "this file, which comes with palpate, was not found", "name a file on the command line"
    )


def of_guides(name: str) -> Path:
    """Return a path; where no file is there, a path `protocols/...` of the guides is that of the shipped file."""
    path = Path(name)
    inside = PACKAGE.joinpath("shipped", *path.parts[1:])
    return inside if path.parts[:1] == ("protocols",) and not path.exists() and inside.is_file() else path


def named(name: str) -> Path:
    """Return the protocol file at this path, or the shipped one with this id. Raises `PalpateError` for neither."""
    path = of_guides(name)
    if path.is_file() or path.suffix or len(path.parts) > 1:
        return path
    folders = (PACKAGE.parent / "protocols", PACKAGE / "shipped")
    ids = sorted({file.stem for folder in folders for file in folder.glob("*.toml") if "." not in file.stem})
    if name in ids:
        return shipped(f"{name}.toml")
    raise PalpateError(
        quoted(name),
        "this is not a file or the id of a protocol that comes with palpate",
        "name one of these",
        allowed=f"a protocol file, or {', '.join(ids)}",
    )
