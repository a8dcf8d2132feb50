"""Write the datasets of this version: `python -m tests.releases`, in the commit that gives the version its number.

Each is a rehearsal of a small study, made once; the tests then hold every later version to it.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

import palpate
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.approval import sealing
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal import study
from tests import formats
from tests.experiment.protocol import leveled
from tests.releases import APPROVED_ON, EXPIRES_ON, FOLDER, FORMATS, RIGS, TRIALS

SMALLER = {
    "okamoto2012": {
        "repetitions = 10 ": "repetitions = 1 ",
        "[50, 100, 200, 300]": "[50, 300]",
        "takes = 3 ": "takes = 1 ",
        "limit = 36\n": "limit = 3\n",
    },
    "wellman1995": {"repetitions = 8 ": "repetitions = 2 ", "limit = 108\n": "limit = 27\n"},
}
"""What makes the shipped studies small."""

PARTICIPANTS = 2


def protocol(name: str, folder: Path) -> Path:
    """Write the small study with this name."""
    if name == "levels":
        return leveled.written(folder, leveled.tapping())
    text = shipped(f"{name}.toml").read_text("utf-8")
    for part, instead in SMALLER[name].items():
        if part not in text:
            sys.exit(f"{name}: there is no {part!r} to make smaller")
        text = text.replace(part, instead)
    file = folder / f"{name}.toml"
    file.write_text(text, "utf-8")
    return file


def seal(file: Path) -> Path:
    """Seal a protocol file for a day, and return it."""
    sealed = files.load(file)
    sealing.write(
        file, sealed, approval_number="none", board=sealed.ethics.board, approved_on=APPROVED_ON, expires_on=EXPIRES_ON
    )
    return file


def main() -> None:
    """Write the datasets of this version. Ends with 1 where they are there already: a release is made once."""
    release = FOLDER / palpate.__version__
    if release.exists():
        sys.exit(f"{release} is there; a release is made once")
    with tempfile.TemporaryDirectory() as made:
        for name, rig in RIGS.items():
            folder, kept = Path(made) / name, Path(made) / "release" / name
            folder.mkdir()
            kept.mkdir(parents=True)
            file = seal(protocol(name, folder))
            for one in (file, approval.seal_path(file)):
                shutil.copy(one, kept)
            root = study.rehearse(
                protocol_file=file,
                rig_file=shipped(rig),
                out=kept / "dataset",
                participants=PARTICIPANTS,
                seed=1,
            )
            for empty in root.rglob(".*.lock"):
                empty.unlink()
            palpate.read(root).attempts.to_csv(kept / TRIALS, index=False)
        names = "\n".join(sorted(formats.descriptions()))
        (Path(made) / "release" / FORMATS).write_text(f"{names}\n", "utf-8")
        shutil.copytree(Path(made) / "release", release)


if __name__ == "__main__":
    main()
