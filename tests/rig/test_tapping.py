"""The tapping study rehearsed through its ports, from the protocol to its tables, by SIMULATED participants.

How near their choices are to the printed ones is judged over three seeds in `rehearsal/kinds/tapping/test_observer.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from palpate.analysis.analyse import analyse
from palpate.analysis.designs.comparison.results import TaskComparisons
from palpate.experiment.dataset.verify import verify
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.study import rehearse


def dataset(folder: Path, text: str, *, name: str = "whole", participants: int = 2, silent: bool = False) -> Path:
    """Rehearse a protocol's text, each pair twice, and return the dataset."""
    protocol = folder / "short.toml"
    protocol.write_text(
        text.replace("repetitions = 8 ", "repetitions = 2 ").replace("limit = 108", "limit = 27"), "utf-8"
    )
    return rehearse(
        protocol_file=protocol,
        rig_file=shipped("rigs/tapping.toml"),
        out=folder / name,
        participants=participants,
        seed=1,
        control="silence" if silent else "none",
        jobs=2,
    )


def rehearsed(folder: Path, text: str, *, silent: bool) -> tuple[TaskComparisons, ...]:
    """Rehearse a protocol's text with 2 participants, and analyse it."""
    root = dataset(folder, text, silent=silent)
    assert verify(root).refused == 0
    tasks: tuple[TaskComparisons, ...] = analyse([root], folder / "out", figures=False).results.tasks
    return tasks


def paper() -> str:
    return shipped("wellman1995.toml").read_text("utf-8")


def virtual_alone(text: str) -> str:
    begins, ends = (text.index(f'[[tasks]]\nid = "{task}"') for task in ("live", "virtual"))
    return (text[:begins] + text[ends:]).replace('["live", "virtual"]', '["virtual"]')


def right(task: TaskComparisons) -> float:
    """Return the share of right choices in pairs of two materials, of 40 trials."""
    different = [pair.right for pair in task.pairs if not pair.same]
    assert sum(one.trials for one in different) == 40
    return sum(one.count for one in different) / 40


def test_both_tasks_give_their_matrices_beside_the_printed_ones(tmp_path: Path) -> None:
    tasks = rehearsed(tmp_path, paper(), silent=False)
    assert [task.task.id for task in tasks] == ["live", "virtual"]
    for task in tasks:
        assert (len(task.participants), task.trials, len(task.pairs)) == (2, 60, 15)
        assert task.in_print is not None
        # The table's own mean over pairs of two materials, within three SDs of 40 trials.
        printed = np.mean([cell.percent for cell in task.in_print.cells if cell.low != cell.high]) / 100
        assert abs(right(task) - printed) < 3 * np.sqrt(printed * (1 - printed) / 40)


def test_silence_in_place_of_the_vibration_leaves_chance(tmp_path: Path) -> None:
    (virtual,) = rehearsed(tmp_path, virtual_alone(paper()), silent=True)
    # An SD of 8 %.
    assert abs(right(virtual) - 0.5) < 0.25


def test_the_same_seed_writes_the_same_files(tmp_path: Path) -> None:
    once, again = (dataset(tmp_path, virtual_alone(paper()), name=name, participants=1) for name in ("once", "again"))
    files = sorted(path.relative_to(once) for path in once.rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(again) for path in again.rglob("*") if path.is_file())
    assert [path for path in files if (once / path).read_bytes() != (again / path).read_bytes()] == []
