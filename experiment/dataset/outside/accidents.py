"""What other systems do to a dataset by accident, each by its name: `palpate verify` reports these as what they are.

Git and transfers in text mode change line ends; macOS leaves files of its own and writes names in another Unicode form;
git-annex and Git LFS leave pointers in place of files; programs that synchronise folders leave copies; archives lose
modes. None of these is an edit of what a participant answered.
"""

import hashlib
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.errors import Finding, Remedy
from palpate.experiment.study import privacy

CHECK = "accidents"
"""The name of the check that its findings have."""

TEXTS = (".jsonl", ".head", ".tsv", ".log")
"""The ends of names of files that palpate writes with LF alone, and reads with nothing else."""

ANNEXED, ON_LFS = b"/annex/objects/", b"version https://git-lfs.github.com/"
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

    A file of palpate that is not there or cannot be read has the verdict `refuses`, any other `unknown`.
    """
    files = [path for path in sorted(root.rglob("*")) if not {".git", "derivatives"} & {*path.relative_to(root).parts}]
    own = {root / name for name in privacy.unknown_files(root)}
    for path in files:
        if path.is_symlink() or path.is_file():
            yield from _of_file(root, path, known=path not in own)
    yield from _copies(root)
    yield from _other_forms(files, root)
    if storage.roster_path(root).exists() and (warning := privacy.readers_warning(root)):
        yield _accident(f"{warning} Archives and copies can lose permissions", root / "sourcedata", root)


def _of_file(root: Path, path: Path, *, known: bool) -> Iterator[Finding]:
    git, name = ("git", "-C", str(root)), path.relative_to(root).as_posix()
    annexed = Remedy("fetch it, then verify again: {}", (*git, "annex", "get", name))
    if path.is_symlink() and not path.exists():
        what, remedy = "is a link to a missing file", "copy that file along with the dataset"
        if "annex" in path.readlink().parts:
            yield _accident("is a link to a git-annex file that was not fetched", path, root, annexed, refuses=known)
        else:
            yield _accident(what, path, root, remedy, refuses=known)
        return
    if not os.access(path, os.R_OK):
        again = Remedy("restore them: {}", ("chmod", "u+rw", str(path)))
        yield _accident("cannot be read: its permissions were lost", path, root, again, refuses=known)
        return
    with path.open("rb") as file:
        start = file.read(64)
    if start.startswith((ANNEXED, ON_LFS)):
        fetch = Remedy("fetch it, then verify again: {}", (*git, "lfs", "pull", "--include", name))
        what = "is a pointer to a file that was not fetched"
        yield _accident(what, path, root, annexed if start.startswith(ANNEXED) else fetch, refuses=known)
    elif known and path.parent != root / storage.RECORDINGS and _has_other_line_ends(path):
        what = "has CR LF line endings instead of LF, probably from Git or a text-mode transfer"
        words = (
            "stop Git from converting line endings ({}) and check the file out again, or copy it again in binary mode"
        )
        yield _accident(what, path, root, Remedy(words, (*git, "config", "core.autocrlf", "false")))


def _has_other_line_ends(path: Path) -> bool:
    """Return whether lines end in CR LF that did not from the start: a lab's own table by its hash in a rig file."""
    if path.suffix not in (*TEXTS, ".csv"):
        return False
    data = storage.read_bytes(path)
    if not 0 < data.count(b"\n") == data.count(b"\r\n"):
        return False
    was = hashlib.sha256(data.replace(b"\r\n", b"\n")).hexdigest().encode()
    return path.suffix in TEXTS or any(was in storage.read_bytes(rig) for rig in path.parent.glob("*.toml"))


def _copies(root: Path) -> Iterator[Finding]:
    """Yield files that macOS or Windows left, and copies by programs that synchronise."""
    for name in privacy.unknown_files(root):
        path = root / name
        system = "macOS" if path.name.startswith("._") else OF_SYSTEMS.get(path.name)
        if system:
            yield _accident(f"was created by {system} and contains no data", path, root, _delete(path))
            continue
        if (original := _original(path)) is not None:
            yield _copy(root, path, original, same=path.is_file() and path.read_bytes() == original.read_bytes())
    for folder in sorted([*root.glob("sub-*"), *root.glob("sourcedata/sub-*")]):
        if folder.is_dir() and (original := _original(folder)) is not None:
            yield _copy(root, folder, original, same=_contents(folder) == _contents(original))


def _original(path: Path) -> Path | None:
    """Return the file or folder of which a sync program made this copy, by its name; None where there is none."""
    stem, dot, ending = path.name.rpartition(".") if "." in path.name else (path.name, "", "")
    marked = next((one for one in COPY.finditer(stem) if one.end() == len(stem) or stem[one.end()] == "."), None)
    original = path.with_name(f"{stem[: marked.start()]}{stem[marked.end() :]}{dot}{ending}") if marked else path
    return original if marked and original.exists() else None


def _copy(root: Path, path: Path, original: Path, *, same: bool) -> Finding:
    other = original.name
    compare = f"compare both files, keep the complete one as {other}, and move the other one out of the dataset"
    what = f"is {'an identical copy' if same else 'another version'} of {other}, made by a sync program"
    return _accident(what, path, root, _delete(path) if same else compare)


def _contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file() and path.suffix != ".lock")
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def _delete(path: Path) -> Remedy:
    return Remedy("delete it", ("rm", *(("-r",) if path.is_dir() else ()), str(path)))


def _other_forms(files: Sequence[Path], root: Path) -> Iterator[Finding]:
    """Yield files whose names are in the decomposed form of Unicode, which palpate does not write."""
    for path in files:
        composed = unicodedata.normalize("NFC", path.name)
        if path.name != composed and not path.with_name(composed).exists():
            what = "has a name in decomposed Unicode, as written by macOS"
            command = ("convmv", "-f", "utf-8", "-t", "utf-8", "--nfc", "--notest", str(path))
            yield _accident(what, path, root, Remedy("rename it", command))


def _accident(what: str, path: Path, root: Path, remedy: Remedy | str = "", *, refuses: bool = False) -> Finding:
    where = path.relative_to(root).as_posix()
    return Finding(what, where, remedy=remedy, verdict="refuses" if refuses else "unknown", check=CHECK)


def with_accidents(root: Path, findings: Sequence[Finding]) -> list[Finding]:
    """Return the findings of a dataset, each refusal that an accident explains replaced by that accident."""
    refusals = [one for one in findings if one.refuses]
    found = [
        replace(one, verdict="refuses") if any(_explains(one, refusal) for refusal in refusals) else one
        for one in accidents(root)
    ]
    found += _lost_folders(root, refusals)
    kept = [one for one in findings if not one.refuses or not any(_explains(each, one) for each in found)]
    return [*kept, *found]


def _lost_folders(root: Path, refusals: Sequence[Finding]) -> Iterator[Finding]:
    """Yield each participant's folder that is gone, where several refusals are of what was in it."""
    of_folders = Counter(_folder(one) for one in refusals)
    for folder, times in of_folders.items():
        if folder and times > 1 and not (root / folder).exists() and (root / folder).parent.exists():
            own = {one.remedy for one in refusals if _folder(one) == folder}
            remedy = own.pop() if len(own) == 1 else "restore it from a backup"
            what = f"the whole folder is missing, which explains {times} of the findings"
            yield Finding(what, folder, remedy=remedy, verdict="refuses", check=CHECK)


def _folder(refusal: Finding) -> str:
    """Return the folder of a participant in which what a refusal needs should be, by its path in the dataset."""
    found = re.match(r"(sourcedata/)?(sub-[^/]+)/", str(refusal.where))
    if found is None:
        return ""
    return f"sourcedata/{found[2]}" if refusal.check == "tables" else f"{found[1] or ''}{found[2]}"


def _explains(accident: Finding, refusal: Finding) -> bool:
    """Return whether a refusal is of the same file, or of one in a folder; a journal and its head are one."""
    if "sub-" in str(accident.where) and str(refusal.where).startswith(f"{accident.where}/"):
        return True
    if accident.where == _folder(refusal):
        return True
    name = unicodedata.normalize("NFC", str(accident.where))
    return re.sub(r"\.(jsonl|head)$", "", name) == re.sub(r"\.(jsonl|head)$", "", str(refusal.where))
