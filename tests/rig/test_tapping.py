"""The tapping study rehearsed whole: from the protocol to its tables, by SIMULATED participants."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import pytest

from analysis.analyse import analyse
from analysis.comparison.results import Compared
from experiment.dataset.verify import verify
from experiment.protocol.files import shipped
from experiment.rehearsal.study import rehearse


def rehearsed(folder: Path, seed: int, control: Literal["none", "silence"] = "none") -> Compared:
    root = rehearse(
        protocol_file=shipped("wellman1995.toml"),
        rig_file=shipped("rigs/tapping.toml"),
        out=folder / "whole",
        participants=None,
        seed=seed,
        control=control,
        jobs=2,
    )
    assert verify(root).refused == 0
    return analyse([root], folder / "out", figures=False).compared


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_choices_are_those_of_the_paper(tmp_path: Path, seed: int) -> None:
    """Tables 2 and 3 of Wellman and Howe, of which the simulation uses nothing, over their 15 cells.

    Table 2 correlates with 0.85 or more. Table 3 does not: no scale at all of five surfaces reaches more than 0.93
    there (aluminum was told from basswood always, from plastic in 57 %, and plastic from basswood in 77 %), and what
    the skin passes gives 0.78.
    """
    live, virtual = rehearsed(tmp_path, seed).tasks
    for task, least in ((live, 0.85), (virtual, 0.7)):
        assert (len(task.participants), task.trials) == (7, 840)
        assert task.in_print is not None
        assert task.in_print.r is not None
        assert task.in_print.r >= least


def test_silence_in_place_of_the_vibration_leaves_chance(tmp_path: Path) -> None:
    _, virtual = rehearsed(tmp_path, 1, "silence").tasks
    different = [pair.right for pair in virtual.pairs if not pair.same]
    share = sum(one.count for one in different) / sum(one.trials for one in different)
    # 560 trials: an SD of 2.1 %.
    assert abs(share - 0.5) < 0.085
