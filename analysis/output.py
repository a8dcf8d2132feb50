"""Writing what an analysis makes: whole files, and never over a file that is not its own.

A manifest in the folder lists the files written and their SHA-256. A file that stands there already is replaced only
if the manifest names it and its bytes are as they were written.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from experiment.errors import DatasetError

MANIFEST = "manifest.json"


def publish(out: Path, files: Mapping[str, bytes], label: str) -> tuple[Path, ...]:
    """Write `files`, path within `out` -> content, and remove what an earlier analysis wrote and this one does not.

    `label` is that of the dataset; it stands in the manifest.

    Raises:
        DatasetError: before anything is written, for a file in the way that is not ours or was changed since; or
            when the file system refuses.
    """
    ours = check(out, files)
    new = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    either = {name: [*ours.get(name, []), *([new[name]] if name in new else [])] for name in {**ours, **new}}
    try:
        _write(out / MANIFEST, _document(either, label))
        for name, content in files.items():
            _write(out / name, content)
        for name in set(ours) - set(files):
            stale = out / name
            if stale.is_file() and _sha256(stale) in ours[name]:
                stale.unlink()
        _write(out / MANIFEST, _document({name: [digest] for name, digest in new.items()}, label))
    except OSError as error:
        raise DatasetError(f"cannot write {error.filename or out}: {error.strerror}; choose another --out") from error
    return tuple(out / name for name in files)


def check(out: Path, names: Iterable[str]) -> dict[str, list[str]]:
    """What stands in a folder of ours, name -> SHA-256; called before what takes its time, it finds a file in the way.

    Raises:
        DatasetError: a file in the way of one of `names` that is not ours or was changed since.
    """
    ours = _manifest(out)
    for name in names:
        path = out / name
        if path.exists() and not (path.is_file() and _sha256(path) in ours.get(name, [])):
            raise DatasetError(
                f"{path} is no output of palpate, or was changed since; move it away or choose another --out"
            )
    return ours


def _manifest(out: Path) -> dict[str, list[str]]:
    path = out / MANIFEST
    if out.exists() and not out.is_dir():
        raise DatasetError(f"{out} is a file; choose a folder for --out")
    if not path.exists():
        return {}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        files = content["palpate analyse"]
        return {str(name): [str(digest) for digest in digests] for name, digests in files.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise DatasetError(f"{path} is no manifest of palpate; move it away or choose another --out") from error


def _document(files: Mapping[str, list[str]], label: str) -> bytes:
    content = {"dataset": label or "measured", "palpate analyse": dict(sorted(files.items()))}
    return (json.dumps(content, indent=2) + "\n").encode()


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}-", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        partial = Path(name)
        partial.chmod(0o644)
        partial.replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
