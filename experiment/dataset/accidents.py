"""What other systems do to a dataset by accident, each by its name: `palpate verify` reports these as what they are.

Git and transfers in text mode change line ends; macOS leaves files of its own and writes names in another Unicode form;
git-annex and Git LFS leave pointers in place of files; programs that synchronise folders leave copies; archives lose
modes. None of these is an edit of what a participant answered.
"""

import os
import re
import unicodedata
from collections.abc import Iterator, Sequence
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.errors import Finding
from palpate.experiment.study import privacy

CHECK = "accidents"
"""The name of the check that its findings have."""

TEXTS = (".jsonl", ".head", ".toml", ".json", ".tsv", ".csv", ".log")
"""The ends of names of files whose lines end in LF alone when palpate writes them."""

POINTERS = (b"/annex/objects/", b"version https://git-lfs.github.com/")
"""How a file begins that stands for another one."""

COPY = re.compile(
    r""" \ \([^()]*conflicted\ copy[^()]*\) | \.sync-conflict-\d{8}-\d{6}(-\w+)? | _conflict-\d{8}-\d{6}
    | \ \(\d{1,3}\) | \ -\ Copy(\ \(\d+\))? | \ copy(\ \d+)? | \ \d{1,2} | -(DESKTOP|LAPTOP)-\w+ """,
    re.VERBOSE,
)
"""What Dropbox and Nextcloud, Syncthing, ownCloud, browsers and Google Drive, Windows, macOS, iCloud and OneDrive put
into the name of a copy, before its last ending."""

OF_SYSTEMS = {".DS_Store": "macOS", "Thumbs.db": "Windows", "desktop.ini": "Windows", ".localized": "macOS"}
"""Files that a system leaves in folders."""

ATTRIBUTES = Path(".gitattributes")
NO_CONVERSION = b"# Git changes no line ends here: hashes hold for the files as they are.\n* -text\n"
"""What stands in that file of a dataset."""


def keep_attributes(root: Path, label: str) -> None:
    """Write `.gitattributes` into a dataset that has none, its label first; one of the lab stays as it is."""
    if not (root / ATTRIBUTES).exists():
        storage.write_bytes(root / ATTRIBUTES, (f"# {label}\n".encode() if label else b"") + NO_CONVERSION)


def accidents(root: Path) -> Iterator[Finding]:
    """Yield each accident that is recognized, with its file by the path inside the dataset.

    A file that cannot be used as it is has the verdict `refuses`, any other `unknown`.
    """
    files = [path for path in sorted(root.rglob("*")) if not {".git", "derivatives"} & {*path.relative_to(root).parts}]
    for path in files:
        if path.is_symlink() or path.is_file():
            yield from _of_file(root, path)
    yield from _copies(root)
    yield from _other_forms(files, root)
    if storage.roster_path(root).exists() and (warning := privacy.readers_warning(root)):
        yield _accident(f"{warning} Archives and copies lose modes", root / "sourcedata", root, refuses=False)


def _of_file(root: Path, path: Path) -> Iterator[Finding]:
    fetch = "fetch it (git annex get, datalad get or git lfs pull), then verify again"
    if path.is_symlink() and not path.exists():
        annexed = "annex" in path.readlink().parts
        what = (
            "is a link to an annexed file that was not fetched" if annexed else "is a link to a file that is not there"
        )
        yield _accident(what, path, root, fetch if annexed else "bring the file with the dataset")
        return
    if not os.access(path, os.R_OK):
        yield _accident("may not be read: its mode was lost", path, root, f"give it back: chmod u+rw {path.name}")
        return
    with path.open("rb") as file:
        start = file.read(64)
    if start.startswith(POINTERS):
        yield _accident("is a pointer to an annexed file that was not fetched", path, root, fetch)
    elif path.suffix in TEXTS and path.parent != root / storage.RECORDINGS and _has_other_line_ends(path):
        what = "has other line ends: CR LF in place of LF, as of Git or a transfer in text mode"
        again = "set git config core.autocrlf false and check it out again, or copy it again in binary mode"
        yield _accident(what, path, root, again)


def _has_other_line_ends(path: Path) -> bool:
    data = storage.read_bytes(path)
    return 0 < data.count(b"\n") == data.count(b"\r\n")


def _copies(root: Path) -> Iterator[Finding]:
    """Yield files that macOS or Windows left, and copies by programs that synchronise."""
    for name in privacy.unknown_files(root):
        path = root / name
        system = "macOS" if path.name.startswith("._") else OF_SYSTEMS.get(path.name)
        if system:
            yield _accident(f"was left by {system}, and holds no data", path, root, "delete it", refuses=False)
            continue
        stem, dot, ending = path.name.rpartition(".")
        marked = next((one for one in COPY.finditer(stem) if one.end() == len(stem) or stem[one.end()] == "."), None)
        original = path.with_name(f"{stem[: marked.start()]}{stem[marked.end() :]}{dot}{ending}") if marked else path
        if not marked or not original.exists():
            continue
        same = path.is_file() and path.read_bytes() == original.read_bytes()
        other = original.name
        remedy = "delete it" if same else f"compare both, keep the one that is whole as {other}, and take this one out"
        what = f"is a copy of {other} by a program that synchronises folders, and {'the same' if same else 'another'}"
        yield _accident(what, path, root, remedy, refuses="_journal" in path.name)


def _other_forms(files: Sequence[Path], root: Path) -> Iterator[Finding]:
    """Yield files whose names are in the decomposed form of Unicode, which palpate does not write."""
    for path in files:
        composed = unicodedata.normalize("NFC", path.name)
        if path.name != composed and not path.with_name(composed).exists():
            what = "has its name in another Unicode form (decomposed, as of macOS)"
            yield _accident(what, path, root, "rename it: convmv -f utf-8 -t utf-8 --nfc --notest")


def _accident(what: str, path: Path, root: Path, remedy: str = "", *, refuses: bool = True) -> Finding:
    where = path.relative_to(root).as_posix()
    return Finding(what, where, remedy=remedy, verdict="refuses" if refuses else "unknown", check=CHECK)


def with_accidents(root: Path, findings: Sequence[Finding]) -> list[Finding]:
    """Return the findings of a dataset, each refusal that an accident explains replaced by that accident."""
    found = list(accidents(root))
    kept = [one for one in findings if one.verdict != "refuses" or not any(_explains(each, one) for each in found)]
    return [*kept, *found]


def _explains(accident: Finding, refusal: Finding) -> bool:
    """Return whether a refusal is of the same file, of a folder that holds it, or of the same session's journal."""
    name, of = str(accident.where), str(refusal.where)
    session = re.sub(r"_(journal\.\w+|rig\.toml|foot\.cobs)$", "", name)
    return accident.verdict == "refuses" and (
        name == of or name.startswith(f"{of}/") or (session != name and of.startswith(f"{session}_"))
    )
