"""Writing the files of an analysis: whole files, never over a file that is not its own, and never among data.

A manifest names the command that wrote there, its files and their SHA-256. Only the same command replaces a file that
is there, if its bytes are as they were written. Everything is on disk under another name before the first file takes
its place, so a full disk changes nothing.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Literal

from experiment import storage
from experiment.errors import DatasetError

MANIFEST = "manifest.json"

Command = Literal["analyse", "export", "numerics", "power", "validate"]

DESCRIPTION, DERIVATIVES = "dataset_description.json", "derivatives"
"""The file that makes a folder a BIDS dataset, and the only place in it for results."""


def publish(out: Path, files: Mapping[str, bytes], label: str, command: Command) -> tuple[Path, ...]:
    """Write `files`, path within `out` -> content, remove what only an earlier run wrote, and return the paths.

    The manifest names the `label` of the dataset and the `command` that writes.

    Raises:
        DatasetError: before anything is written, see `check`; or if the file system refuses.
    """
    ours = check(out, files, command)
    new = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    either = {name: [*ours.get(name, []), *([new[name]] if name in new else [])] for name in {**ours, **new}}
    made = not out.exists()
    staged: list[tuple[Path, Path]] = []
    try:
        _stage(staged, out / MANIFEST, _document(either, label, command))
        for name, content in files.items():
            _stage(staged, out / name, content)
        _stage(staged, out / MANIFEST, _document({name: [digest] for name, digest in new.items()}, label, command))
        while staged:
            partial, path = staged[0]
            if path == out / MANIFEST and len(staged) == 1:
                for name in set(ours) - set(files):
                    if (stale := out / name).is_file() and _sha256(stale) in ours[name]:
                        stale.unlink()
            partial.replace(path)
            del staged[0]
    except OSError as error:
        raise DatasetError(f"cannot write {error.filename or out}: {error.strerror}; choose another --out") from error
    finally:
        _clean(staged, out, made=made)
    return tuple(out / name for name in files)


def _clean(staged: list[tuple[Path, Path]], out: Path, *, made: bool) -> None:
    """Remove the files that did not take their place, and the folders made for them."""
    for partial, _ in staged:
        partial.unlink(missing_ok=True)
    if made and staged:
        for folder in sorted((out, *out.rglob("*")), reverse=True):
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()


def check(out: Path, names: Iterable[str], command: Command) -> dict[str, list[str]]:
    """Return the files in a folder of ours, name -> SHA-256; call it before long work to find what is in the way.

    Raises:
        DatasetError: for a folder within a dataset, save below its `derivatives`; for one that another command wrote;
            and for a file in the way of one of `names` that is not ours or was changed since.
    """
    _beside_data(out)
    ours = _manifest(out, command)
    for name in names:
        path = out / name
        if path.exists() and not (path.is_file() and _sha256(path) in ours.get(name, [])):
            raise DatasetError(
                f"{path} is no output of palpate, or was changed since; move it away or choose another --out"
            )
    return ours


def _beside_data(out: Path) -> None:
    inside = out.resolve()
    for folder in (inside, *inside.parents):
        if _holds_data(folder / DESCRIPTION) and folder / DERIVATIVES not in inside.parents:
            raise DatasetError(
                f"--out {out} lies within the dataset {folder}; allowed there: a folder below {folder / DERIVATIVES}; "
                "choose another --out"
            )


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
        raise DatasetError(f"{out} is a file; choose a folder for --out")
    if not path.exists():
        if out.exists() and any(out.iterdir()):
            raise DatasetError(f"{out} holds files that are not palpate's; choose a new or empty folder for --out")
        return {}
    try:
        content = storage.json_of(storage.read_bytes(path))
        wrote, files = str(content["command"]), content["palpate"]
        ours = {str(name): [str(digest) for digest in digests] for name, digests in files.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise DatasetError(
            f"{path} is not a manifest of this version of palpate; move the folder away or choose another --out"
        ) from error
    if wrote != command:
        raise DatasetError(
            f"{out} holds what `palpate {wrote}` wrote, which `palpate {command}` would remove; choose another --out"
        )
    return ours


def _document(files: Mapping[str, list[str]], label: str, command: Command) -> bytes:
    content = {"command": command, "dataset": label or "measured", "palpate": dict(sorted(files.items()))}
    return (json.dumps(content, indent=2) + "\n").encode()


def _sha256(path: Path) -> str:
    return hashlib.sha256(storage.read_bytes(path)).hexdigest()


def _stage(staged: list[tuple[Path, Path]], path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}-", dir=path.parent)
    partial = Path(name)
    staged.append((partial, path))
    with os.fdopen(handle, "wb") as file:
        file.write(content)
    partial.chmod(0o644)
