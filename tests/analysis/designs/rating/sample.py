"""A small dataset of ratings, with its protocol."""

from __future__ import annotations

from pathlib import Path

import tomlkit

from tests.analysis.datasets import trials, write_dataset
from tests.experiment.protocol import rating as rated

MATERIALS: tuple[str, ...] = tuple(one["id"] for one in rated.study()["materials"])

SAID: dict[str, list[tuple[int, int | None]]] = {
    # Two ratings of each material by three participants, and one trial without an answer.
    "1": [(0, 1), (1, 2), (2, 4), (2, 4), (1, 2), (0, 1)],
    "2": [(2, 5), (0, 2), (1, 3), (0, 2), (1, 4), (2, 5)],
    "3": [(1, 2), (2, 3), (0, 1), (2, None), (0, 1), (1, 4)],
}


def dataset(root: Path, scale: tuple[str, ...] = ("1", "2", "3", "4", "5")) -> Path:
    sessions = {
        who: {"virtual": trials((MATERIALS[which], "(none)" if much is None else str(much)) for which, much in said)}
        for who, said in SAID.items()
    }
    write_dataset(
        root, sessions, study="rated", materials=MATERIALS, tasks=("virtual",), answers=scale, origin="REHEARSAL",
        kind="footstep", design="rating",
    )  # fmt: skip
    (root / "sourcedata").mkdir(exist_ok=True)
    (root / "sourcedata" / "protocol.toml").write_text(tomlkit.dumps(rated.study()), "utf-8")
    return root


def sample(folder: Path) -> Path:
    return dataset(folder / "study")
