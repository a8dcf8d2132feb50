"""Writing the files of an analysis: whole files, never over a file that is not its own, and never among data.

A manifest names the command, its files and their SHA-256; only the same command replaces unchanged files. All files are
in a temporary folder before the first is moved, and the manifest names old and new, so that a kill harms nothing.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Literal

from palpate.experiment import storage
from palpate.experiment.errors import DatasetError

MANIFEST = "manifest.json"

Command = Literal["analyse", "export", "numerics", "power", "validate"]

DESCRIPTION, DERIVATIVES = "dataset_description.json", "derivatives"
"""The file that makes a folder a BIDS dataset, and the only place in it for results."""


def publish(out: Path, files: Mapping[str, bytes], label: str, command: Command) -> tuple[Path, ...]:
    """Write `files`, path within `out` -> content, remove what only an earlier run wrote, and return the paths.

    The manifest names `label` and `command`. Raises `DatasetError` as `check`, or if the file system refuses.
    """
    ours = check(out, files, command)
    new = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    either = {name: [*ours.get(name, []), *([new[name]] if name in new else [])] for name in {**ours, **new}}
    made = not out.exists()
    try:
        with storage.temporary(out) as staged:
            for name, content in files.items():
                storage.create(staged / name, content)
            storage.create(staged / MANIFEST, _document({name: [sha] for name, sha in new.items()}, label, command))
            storage.write(out / MANIFEST, _document(either, label, command))
            for name in files:
                (out / name).parent.mkdir(parents=True, exist_ok=True)
                (staged / name).replace(out / name)
            for name in set(ours) - set(files):
                if (stale := out / name).is_file() and _sha256(stale) in ours[name]:
                    stale.unlink()
            (staged / MANIFEST).replace(out / MANIFEST)
        for folder in {(out / name).parent for name in files}:
            storage.sync_folder(folder)
    except OSError as error:
        if made:
            with suppress(OSError):
                out.rmdir()
        raise DatasetError(
            f"cannot write {error.filename or out}: {error.strerror}", remedy="choose another --out"
        ) from error
    return tuple(out / name for name in files)


def check(out: Path, names: Iterable[str], command: Command) -> dict[str, list[str]]:
    """Return a folder's own files, name -> SHA-256; call it before long work to find what is in the way.

    Raises `DatasetError` within a dataset (save its `derivatives`), for a folder of another command, a file of `names`
    that is not ours or was changed, and a link or manifest that leads outside.
    """
    inside = out.resolve()
    for folder in (inside, *inside.parents):
        if _holds_data(folder / DESCRIPTION) and folder / DERIVATIVES not in inside.parents:
            raise DatasetError(
                f"--out {out}",
                f"is inside the dataset {folder}",
                "choose another --out",
                allowed=f"a folder below {folder / DERIVATIVES}",
            )
    ours = _manifest(out, command)
    for name in {**dict.fromkeys(names), **ours}:
        if not (out / name).parent.resolve().is_relative_to(inside):
            raise DatasetError(
                f"{out / name} leads outside {out} because of a link or an entry in {out / MANIFEST}",
                remedy="remove the link or entry, or choose another --out",
            )
    for name in names:
        path = out / name
        if (path.exists() or path.is_symlink()) and not (path.is_file() and _sha256(path) in ours.get(name, [])):
            raise DatasetError(
                f"{path} is not palpate output, or was changed later", remedy="move it away or choose another --out"
            )
    return ours


def _holds_data(description: Path) -> bool:
    """Return whether this describes a dataset, and not results; an unreadable description counts as a dataset."""
    if not description.is_file():
        return False
    try:
        content = storage.json_of(storage.read_bytes(description))
    except (OSError, ValueError):
        return True
    return not (isinstance(content, dict) and content.get("DatasetType") == "derivative")


def _manifest(out: Path, command: Command) -> dict[str, list[str]]:
    path = out / MANIFEST
    if out.exists() and not out.is_dir():
        raise DatasetError(f"{out} is a file", remedy="choose a folder for --out")
    if not path.exists():
        if out.exists() and not all(storage.TEMPORARY.fullmatch(inside.name) for inside in out.iterdir()):
            raise DatasetError(
                f"{out} contains files that palpate did not write", remedy="choose a new or empty folder for --out"
            )
        return {}
    try:
        content = storage.json_of(storage.read_bytes(path))
        wrote, files = str(content["command"]), content["palpate"]
        ours = {str(name): [str(digest) for digest in digests] for name, digests in files.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise DatasetError(
            f"{path} is not a manifest of this version of palpate",
            remedy="move the folder away or choose another --out",
        ) from error
    if wrote != command:
        raise DatasetError(
            f"{out} contains output of `palpate {wrote}`, which `palpate {command}` would remove",
            remedy="choose another --out",
        )
    return ours


def _document(files: Mapping[str, list[str]], label: str, command: Command) -> bytes:
    content = {"command": command, "dataset": label or "measured", "palpate": dict(sorted(files.items()))}
    return (json.dumps(content, indent=2) + "\n").encode()


def _sha256(path: Path) -> str:
    return hashlib.sha256(storage.read_bytes(path)).hexdigest()
