"""Who else can read what participants gave, and which files beside those of palpate may hold it."""

import re
import shlex
import sys
from contextlib import suppress
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.errors import PalpateError
from palpate.experiment.protocol import files


def to_close(dataset: Path) -> str:
    """Return what to do where others can read."""
    command = f"chmod -R go-rwx {shlex.quote(str(dataset))}"
    return f"remove their access ({command}), or use a file system that has permissions or is mounted only for you"


def readable_by_others(dataset: Path) -> tuple[Path, ...]:
    """Return which of a dataset's folder of people, seed, roster and tables of answers others here can read."""
    source = dataset / "sourcedata"
    if (
        sys.platform == "win32"
        or not source.is_dir()
        or not all(_is_open(one, 0o11) for one in source.resolve().parents)
    ):
        return ()
    places = (source, storage.seed_path(dataset), storage.roster_path(dataset)) if _is_open(source, 0o11) else (source,)
    asked = (dataset / "participants.tsv",) if any(source.glob("sub-*/sub-*_facts.json")) else ()
    places += (*asked, *sorted(dataset.glob("phenotype/*.tsv")))
    return tuple(one for one in places if one.exists() and _is_open(one, 0o44))


def _is_open(path: Path, bits: int) -> bool:
    """Return whether others have one of these bits; a group that may write shares the files."""
    mode = path.stat().st_mode
    return bool(mode & bits & (0o07 if mode & 0o20 else 0o77))


def readers_warning(dataset: Path) -> str:
    """Return in words what `readable_by_others` found, and what to do; empty for nothing."""
    shown = ", ".join(map(str, readable_by_others(dataset)))
    return f"Other users of this computer can read {shown}; {to_close(dataset)}." if shown else ""


_KNOWN = re.compile(
    r"""(README|\.gitattributes|dataset_description\.json|participants\.(tsv|json)|phenotype/\w+\.(tsv|json)|stimuli/(?!(.*/)?\.(_|DS_Store)).*|derivatives/.*
    |sub-(?P<of>\w+)/beh/sub-(?P=of)_task-\w+_(events|recording-\w+_physio)\.(tsv|tsv\.gz|json)
    |sourcedata/(protocol(-\d+)?(\.seal)?\.toml|(seed|rehearsal|shared)\.json|roster\.(jsonl|head)|anchors\.log|README|\w+\.csv
        |\.roster\.jsonl\.lock|\.study\.lock
        |sub-(?P<who>\w+)/(\.sub-(?P=who)\.lock|sub-(?P=who)_(withdrawn|shared|facts(\.new)?)\.json|voices/(?!\._)[\w.-]+|[\w-]+\.(csv|toml)
            |sub-(?P=who)_task-\w+_(journal\.(jsonl|head)|foot\.cobs|force\.bin))))""",
    re.VERBOSE | re.DOTALL,
)
"""Every file that palpate writes into a dataset, by its path inside."""


def unknown_files(dataset: Path) -> list[str]:
    """Return the files of a dataset that palpate did not write, by their paths inside: a sync copy, say."""
    paths = (path.relative_to(dataset).as_posix() for path in dataset.rglob("*") if path.is_symlink() or path.is_file())
    unknown = sorted(path for path in paths if not _KNOWN.fullmatch(path))
    beside = _beside_protocols(dataset) if any(path.startswith("sourcedata/") for path in unknown) else ()
    return [path for path in unknown if path not in beside]


def _beside_protocols(dataset: Path) -> set[str]:
    """Return the files that stand beside the dataset's protocols, as far as these can be read."""
    known = set[str]()
    for path in storage.protocol_paths(dataset):
        with suppress(PalpateError):
            known.update(f"sourcedata/{name}" for name in files.load(path).companions)
    return known
