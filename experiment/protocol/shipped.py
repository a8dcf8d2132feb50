"""Where the files under protocols/ stand that come with palpate."""

from __future__ import annotations

from pathlib import Path

from experiment.errors import PalpateError

PACKAGE = Path(__file__).parent.parent


def shipped(name: str) -> Path:
    """A file under protocols/: of the working folder, of the checkout, or the copy in the installed package.

    Args:
        name: path below protocols/, such as `okamoto2012.toml` or `rigs/rehearsal.toml`.

    Raises:
        PalpateError: none of them has it.
    """
    for folder in (Path("protocols"), PACKAGE.parent / "protocols", PACKAGE / "shipped"):
        if (folder / name).is_file():
            return folder / name
    raise PalpateError(f"protocols/{name} is nowhere to be found; name a file on the command line")
