"""The numbers that published studies print, with where each stands.

A TOML file of a paper comes in (`README.md` here says how to write one) and is checked for every error at once.
`Published` comes out, where each number keeps its text, so that its last digit is known. The room knows what a printed
number can stand for, and nothing of how it is recomputed.
"""

from importlib import resources
from pathlib import Path

from palpate.analysis.published.numbers import Published
from palpate.experiment.errors import ProtocolError, PublishedError


def shipped() -> dict[str, Path]:
    """Return the file of printed numbers of each study that palpate brings along, by the study's id."""
    folder = Path(str(resources.files(__name__)))
    return {path.stem: path for path in sorted(folder.glob("*.toml")) if not path.stem.endswith("_spectra")}


def load(study: str) -> Published | None:
    """Return the printed numbers of the study with this id, or None where palpate brings none along."""
    file = shipped().get(study)
    return read(file) if file else None


def read(path: Path) -> Published:
    """Return the printed numbers in the file at `path`.

    Raises `PublishedError` with every problem of the file at once.
    """
    from palpate.experiment.settings import load as files

    try:
        return files.read(path, Published)
    except ProtocolError as error:
        raise PublishedError.saying(error) from error
