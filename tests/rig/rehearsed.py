"""One rehearsal of the shipped protocol on the shipped rig, and the trials that count in it."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal import study


def rehearse(out: Path, **changed: Any) -> Path:
    asked: dict[str, Any] = {"participants": 1, "seed": 1, "rig_file": shipped("rigs/rehearsal.toml")} | changed
    return study.rehearse(protocol_file=shipped("okamoto2012.toml"), out=out, **asked)


def counted(root: Path, task: str) -> list[dict[str, str]]:
    rows = []
    for path in sorted(root.glob(f"sub-*/beh/*_task-{task}_events.tsv")):
        with path.open() as file:
            rows += [row for row in csv.DictReader(file, delimiter="\t") if row["counted"] == "1"]
    return rows


def assert_all_say(root: Path, label: str) -> None:
    """Every file of a dataset says what it is of, but for those that cannot."""
    for path in sorted(root.rglob("*")):
        relative = path.relative_to(root).as_posix()
        if (
            not path.is_file()
            or path.name == "protocol.toml"
            or path.suffix in (".lock", ".bin", ".cobs", ".head", ".wav", ".gz")
        ):
            continue
        text = path.read_text("utf-8")
        if path.suffix == ".jsonl":
            assert f'"purpose":"{label}"' in text, relative
        elif path.suffix == ".csv":
            assert text.startswith("# SIMULATED"), relative
        elif path.suffix == ".toml":
            assert "simulated = true" in text, relative
        elif path.suffix == ".tsv":
            assert all(label in line for line in text.splitlines()[1:]), relative
        else:
            assert label in re.sub(r'"Levels": \{[^}]*\}', "", text), relative
