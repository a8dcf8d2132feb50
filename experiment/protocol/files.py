"""Protocol files: reading one, and finding those that come with palpate."""

from __future__ import annotations

from pathlib import Path

from experiment.errors import PalpateError
from experiment.protocol.models import Protocol
from experiment.settings.load import read

PACKAGE = Path(__file__).parent.parent


def load(path: Path) -> Protocol:
    """Read the protocol file at `path`.

    Raises:
        ProtocolError: with every problem of the file; of its syntax, the first.
    """
    return read(path, Protocol)


def shipped(name: str) -> Path:
    """Return a file under protocols/: of the working folder, of the checkout, or the installed package's copy.

    Args:
        name: path below protocols/, such as `okamoto2012.toml` or `rigs/rehearsal.toml`.

    Raises:
        PalpateError: none of them has it.
    """
    for folder in (Path("protocols"), PACKAGE.parent / "protocols", PACKAGE / "shipped"):
        if (folder / name).is_file():
            return folder / name
    raise PalpateError(f"protocols/{name} is nowhere to be found; name a file on the command line")
