"""Protocol files: reading one, and finding those that come with palpate."""

from pathlib import Path

from palpate.experiment.errors import PalpateError
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.settings.characters import quoted
from palpate.experiment.settings.load import read

PACKAGE = Path(__file__).parent.parent


def load(path: Path) -> Protocol:
    """Return the protocol at `path`. Raises `ProtocolError` with all its problems, or its first syntax error."""
    return read(path, Protocol)


def shipped(name: str) -> Path:
    """Return the file `name` of protocols/ in working folder, checkout or package. Raises `PalpateError` for none."""
    for folder in (Path("protocols"), PACKAGE.parent / "protocols", PACKAGE / "shipped"):
        if (folder / name).is_file():
            return folder / name
    raise PalpateError(f"protocols/{name}", "the shipped file was not found", "name a file on the command line")


def named(name: str) -> Path:
    """Return the protocol file at this path, or the shipped one with this id. Raises `PalpateError` for neither."""
    path = Path(name)
    if path.is_file() or path.suffix or len(path.parts) > 1:
        return path
    folders = (PACKAGE.parent / "protocols", PACKAGE / "shipped")
    ids = sorted({file.stem for folder in folders for file in folder.glob("*.toml") if "." not in file.stem})
    if name in ids:
        return shipped(f"{name}.toml")
    raise PalpateError(
        quoted(name),
        "got neither a file nor the id of a protocol that comes with palpate",
        "name one of these",
        allowed=f"a protocol file, or {', '.join(ids)}",
    )
