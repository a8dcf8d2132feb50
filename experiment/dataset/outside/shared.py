"""Whether a shared copy of a dataset is still what was shared: no journal stands behind it, but a list of its files."""

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.dataset.tables import READ
from palpate.experiment.errors import Finding, Verdict
from palpate.experiment.study import privacy

CHECK = "shared"
"""The name of the check that its findings have."""

DESCRIPTION = "dataset_description.json"

OF_RECIPIENTS = ("README", "CHANGES", "LICENSE", ".gitattributes", ".bidsignore")
"""Files at the top that whoever publishes a copy may change."""

FOLDERS = ("derivatives/", ".git/", ".datalad/")
"""Folders at the top that are theirs, too."""

REMEDY = "download it again from where the copy was published"


def file_hashes(root: Path) -> dict[str, str]:
    """Return the SHA-256 of each file of a copy but the list itself, by its path; of the description, of what is read.

    Authors, licence and DOI in the description may change, and so may the files `OF_RECIPIENTS`.
    """
    files = (path for path in sorted(root.rglob("*")) if path.is_file() and path != storage.shared_path(root))
    named = {path.relative_to(root).as_posix(): path for path in files}
    return {name: _sha256(path) for name, path in named.items() if not _is_theirs(name)}


def _is_theirs(name: str) -> bool:
    return name in OF_RECIPIENTS or name.startswith(FOLDERS)


def _sha256(path: Path) -> str:
    content = storage.read_bytes(path)
    if path.name == DESCRIPTION:
        found = storage.json_of(content)
        content = storage.json_bytes({key: found.get(key) for key in READ[DESCRIPTION]})
    return hashlib.sha256(content).hexdigest()


def findings(root: Path) -> Iterator[Finding]:
    """Yield each file of a copy that is missing, another than was shared, or was not shared; or that all are as shared.

    What cannot be read is among them. What was not shared refuses if it has a name that palpate gives, so that it could
    be read as if it had been.
    """
    listed = storage.shared_path(root)
    try:
        files: Mapping[str, str] = storage.json_of(storage.read_bytes(listed))["files"]
        there = file_hashes(root)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        what = storage.why(error) if isinstance(error, OSError | ValueError) else "it is not a list of files"
        yield Finding(f"cannot be read ({what})", listed, remedy=REMEDY, check=CHECK)
        return
    unlike = [name for name in sorted(files) if files[name] != there.get(name)]
    for name in unlike:
        what = "differs from the shared file" if name in there else "is missing"
        yield Finding(what, root / name, remedy=REMEDY, check=CHECK)
    foreign, unread = sorted({*there} - {*files}), privacy.unknown_files(root)
    for name in foreign:
        verdict: Verdict = "unknown" if name in unread else "refuses"
        yield Finding("was not shared", root / name, remedy="move it out of the copy", verdict=verdict, check=CHECK)
    if not unlike and {*foreign} <= {*unread}:
        yield Finding(f"{len(files)} match the shared files", "files", verdict="passes", check=CHECK)
