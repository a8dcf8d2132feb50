"""The tapping study rehearsed whole: from the protocol to its tables, by SIMULATED participants."""

from __future__ import annotations

from pathlib import Path

import pytest

from analysis.analyse import analyse
from experiment.dataset.verify import verify
from experiment.protocol.files import shipped
from experiment.rehearsal.study import rehearse


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_choices_are_those_of_the_paper(tmp_path: Path, seed: int) -> None:
    """Table 2 of Wellman and Howe, of which the simulation uses nothing: at least 0.85 over its 15 cells."""
    root = rehearse(
        protocol_file=shipped("wellman1995.toml"),
        rig_file=shipped("rigs/rehearsal.toml"),
        out=tmp_path / "whole",
        participants=None,
        seed=seed,
        jobs=2,
    )
    assert verify(root).refused == 0
    (task,) = analyse([root], tmp_path / "out", figures=False).compared.tasks
    assert (len(task.participants), task.trials) == (7, 840)
    assert task.in_print is not None
    assert task.in_print.r is not None
    assert task.in_print.r >= 0.85
