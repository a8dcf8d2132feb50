"""Protocol files: reading one, and finding those that come with palpate."""

from __future__ import annotations

from pathlib import Path

from palpate.experiment.errors import DatasetError, PalpateError, Problem, ProtocolError
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.settings.characters import quoted
from palpate.experiment.settings.load import checked, locate, parsed

PACKAGE = Path(__file__).parent.parent

FORMAT_1_MOVES = (
    '2; write format = 2, add kind = "footstep" to every [[tasks]], and rename the tables [step] to [footstep.step], '
    "[synthesis] to [footstep.synthesis] and [tactile] to [footstep.tactile]; orders of trials stay the same, and the "
    "board approves the new file"
)
"""What a protocol of format 1 needs to become one of format 2."""


def load(path: Path) -> Protocol:
    """Read the protocol file at `path`.

    Raises `ProtocolError` with every problem of the file, or with the first of its syntax. For an older format it says
    what to move where.
    """
    document, text = parsed(path)
    if document.get("format") == 1:
        raise ProtocolError(str(path), [Problem("format", locate(text).get(("format",)), "1", FORMAT_1_MOVES)])
    return checked(path, Protocol, document, text)


def load_kept(path: Path) -> Protocol:
    """Return the protocol of which a dataset keeps a copy, which nobody may change. Raises as `load`.

    Raises `DatasetError` if the copy is of an older format.
    """
    document, text = parsed(path)
    if document.get("format") == 1:
        raise DatasetError(
            f"{path}: got a dataset whose protocol is of format 1; allowed: format 2; use the palpate that made the "
            "dataset, and leave the file as it is"
        )
    return checked(path, Protocol, document, text)


def shipped(name: str) -> Path:
    """Return the file `name` under protocols/: of the working folder, of the checkout, or the installed package's copy.

    Raises `PalpateError` if none of them has it.
    """
    for folder in (Path("protocols"), PACKAGE.parent / "protocols", PACKAGE / "shipped"):
        if (folder / name).is_file():
            return folder / name
    raise PalpateError(f"protocols/{name}: the shipped file was not found; name a file on the command line")


def named(name: str) -> Path:
    """Return the protocol file of this path, or the one that comes with palpate and has this id.

    Raises `PalpateError` if a word is neither.
    """
    path = Path(name)
    if path.is_file() or path.suffix or len(path.parts) > 1:
        return path
    folders = (PACKAGE.parent / "protocols", PACKAGE / "shipped")
    ids = sorted({file.stem for folder in folders for file in folder.glob("*.toml") if "." not in file.stem})
    if name in ids:
        return shipped(f"{name}.toml")
    raise PalpateError(
        f"{quoted(name)}: got neither a file nor the id of a protocol that comes with palpate; allowed: a protocol "
        f"file, or {', '.join(ids)}; name one of these"
    )
