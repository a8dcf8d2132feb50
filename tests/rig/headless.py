"""The footstep study in short, for rehearsals in real time on a sound card of software, and what was answered in it."""

from __future__ import annotations

import csv
import re
from pathlib import Path

from palpate.experiment.protocol.files import shipped


def short(tmp_path: Path) -> Path:
    """The footstep study with four trials a task and hardly a break."""
    text = shipped("okamoto2012.toml").read_text("utf-8")
    for pattern, value in (("repetitions", "1"), ("min_s", "0"), ("max_s", "0.01"), ("break_min_s", "0")):
        text = re.sub(rf"(?m)^{pattern} = \S+", f"{pattern} = {value}", text)
    text = text.replace("limit = 36", "limit = 4")
    text = text.replace("[masker]\n", '[masker]\nprobe = { material = "aluminum foil", speed_mm_s = 200 }\n')
    path = tmp_path / "short.toml"
    path.write_text(text, "utf-8")
    return path


def tried(root: Path, task: str) -> list[dict[str, str]]:
    [path] = root.glob(f"sub-01/beh/*_task-{task}_events.tsv")
    with path.open() as file:
        return list(csv.DictReader(file, delimiter="\t"))


def answers(root: Path, task: str) -> list[dict[str, str]]:
    return [row for row in tried(root, task) if row["counted"] == "1"]
