"""One rehearsal of the shipped protocol on the shipped rig, and the trials that count in it."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

from experiment.protocol.files import shipped
from experiment.rehearsal import study


def rehearse(out: Path, **changed: Any) -> Path:
    asked: dict[str, Any] = {"participants": 1, "seed": 1} | changed
    return study.rehearse(
        protocol_file=shipped("okamoto2012.toml"), rig_file=shipped("rigs/rehearsal.toml"), out=out, **asked
    )


def counted(root: Path, task: str) -> list[dict[str, str]]:
    rows = []
    for path in sorted(root.glob(f"sub-*/beh/*_task-{task}_events.tsv")):
        with path.open() as file:
            rows += [row for row in csv.DictReader(file, delimiter="\t") if row["counted"] == "1"]
    return rows
