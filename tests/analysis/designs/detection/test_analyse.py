"""A whole analysis of detection: thresholds by rule and fit, tracks, d' against R, tables and files."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
import tomlkit
from syrupy.assertion import SnapshotAssertion

import palpate
from palpate.analysis.analyse import Analysis, analyse
from palpate.analysis.designs import detection
from palpate.analysis.designs.detection import results
from palpate.analysis.export import files
from palpate.analysis.reading.dataset import read
from palpate.analysis.reading.pooled import read_pooled
from palpate.analysis.statistics.participants import mean
from palpate.experiment.errors import DatasetError
from palpate.experiment.protocol.models import Levels
from palpate.experiment.study.levels.quest_plus import QuestPlus
from tests.analysis.designs.detection.sample import SIGNAL, TABLES, TRACK, dataset, two_rows, yes_no_rows
from tests.approved import anywhere
from tests.experiment.protocol.detection import UP_DOWN
from tests.experiment.study.levels.test_up_down import naive_reversals


@pytest.fixture(scope="module")
def analysed(tmp_path_factory: pytest.TempPathFactory) -> Analysis:
    place = tmp_path_factory.mktemp("detection")
    return analyse([dataset(place / "study")], place / "out")


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Analysis:
    place = tmp_path_factory.mktemp("intervals")
    return analyse([dataset(place / "study", 2)], place / "out")


@pytest.mark.parametrize("which", ["analysed", "two"])
def test_every_screen(which: str, request: pytest.FixtureRequest, approved: SnapshotAssertion) -> None:
    found: Analysis = request.getfixturevalue(which)
    assert anywhere(found.text(full=True), found.out.parent) == approved


def test_d_of_yes_or_no_is_rs(analysed: Analysis) -> None:
    """R 4.2.2: qnorm(H) - qnorm(2.5 / 21), and -(sum) / 2, with H = c(1.5, 3.5, 8.5, 10.5) / 11, of participant 1."""
    (task,) = analysed.results.tasks
    levels = task.tracks[0].by_level
    assert [(one.hits, one.signals, one.false_alarms, one.others) for one in levels] == [
        (1, 10, 2, 20), (3, 10, 2, 20), (8, 10, 2, 20), (10, 10, 2, 20),
    ]  # fmt: skip
    assert [one.d.d for one in levels] == pytest.approx(D_YES_NO, abs=1e-8)
    assert [one.d.criterion for one in levels] == pytest.approx(C_YES_NO, abs=1e-8)
    assert {one.d.rule for one in levels} == {"yes or no"}


D_YES_NO = (0.0829575555183, 0.7069719966196, 1.9276197123752, 2.8703827471968)
C_YES_NO = (1.138282339853, 0.826275119302, 0.215951261424, -0.255430255987)


def test_guesses_of_yes_or_no_are_false_alarms(analysed: Analysis) -> None:
    (task,) = analysed.results.tasks
    assert [(one.trials, one.false_alarms) for one in task.catches] == [(20, 2), (20, 1)]
    assert [one.guess for one in task.tracks] == pytest.approx([2 / 20, 1 / 20])
    assert {one.estimate.method for one in task.tracks} == {"constant"}
    assert task.thresholds[0].fitted.n == 2


def test_a_staircase_has_its_reversals_and_their_mean(two: Analysis) -> None:
    """Turns by hand: "++" "++" "-" "++" "-" "+-" "++" "++" "-" "++" "-", each at its last trial."""
    (task,) = two.results.tasks
    (track,) = task.tracks
    answers = "".join("+" if one.right else "-" for one in track.steps)
    turned = [one.x_db for one in track.steps if one.reversal]
    assert [one.trial for one in track.steps if one.reversal] == [5, 7, 8, 12, 15, 17, 18]
    assert len(turned) == naive_reversals(answers, 2)
    kept = turned[len(turned) % 2 :]
    assert track.estimate.db == pytest.approx(np.mean(kept))
    # Levitt (1971): p^2 = 1/2.
    assert track.estimate.share == pytest.approx(2**-0.5)
    assert track.guess == 0.5
    assert {one.d.rule for one in track.by_level if one.d} == {"two intervals"}


def test_reversals_are_those_of_the_session() -> None:
    rng = np.random.default_rng(1)
    for down in (1, 2, 3):
        rule = Levels(method="up-down", grid=(0.1, 0.2, 0.4), first=0.2, down=down, reversals=9)
        answers = rng.random(60) < 0.7
        text = "".join("+" if one else "-" for one in answers)
        assert len(results.reversals(answers.tolist(), rule)) == naive_reversals(text, down)
    assert results.reversals([True, False], None) == ()


def test_a_posterior_is_that_of_the_session() -> None:
    rule = Levels(
        method="quest-plus", grid=(0.1, 0.2, 0.4, 0.8), thresholds=(0.1, 0.2, 0.4), spreads_db=(2.0, 6.0),
        lapses=(0.0, 0.04), guess=0.5,
    )  # fmt: skip
    answers = [(0.8, True), (0.4, True), (0.1, False), (0.2, True), (0.2, False)]
    method = QuestPlus(rule)
    state = method.init()
    for level, said in answers:
        state = method.step(state, level=level, right=said)
    x, right = (np.array(one) for one in zip(*answers, strict=True))
    found = results.threshold_by_rule(20 * np.log10(x), right, (), rule, np.ones(5, dtype=bool))
    assert (found.db, found.sd) == pytest.approx(method.threshold_db(state), abs=1e-9)
    one = rule.model_copy(update={"lapses": (0.04,)})
    found = results.threshold_by_rule(20 * np.log10(x), right, (), one, np.ones(5, dtype=bool))
    # Half of what is neither guessed nor missed: 0.5 + (1 - 0.5 - 0.04) / 2.
    assert found.share == pytest.approx(0.73)


def test_a_staircase_turned_by_a_trial_that_is_left_out(tmp_path: Path) -> None:
    """Three down, one up by RRRWRRRW: turned at its 4th, 7th and 8th trial, whichever of the others is left out."""
    tasks = (TABLES[2]["tasks"][0] | {"levels": UP_DOWN | {"down": 3}},)
    left_out = ({"id": "off", "when": "undelivered", "action": "exclude-trial", "reason": "not played"},)
    rows = [one | {"delivered": one["trial"] != 1} for one in two_rows("+++-+++-")]
    root = dataset(tmp_path / "study", 2, rows={"1": rows}, tasks=tasks, exclusion=left_out)
    (track,) = results.compute(read(root)).tasks[0].tracks
    assert [one.trial for one in track.steps if one.reversal] == [4, 7, 8]
    assert [one.trial for one in track.steps] == [2, 3, 4, 5, 6, 7, 8]


def test_catch_trials_without_a_yes_move_no_threshold(tmp_path: Path) -> None:
    fits = set()
    for catches in (2, 5, 20):
        rows = yes_no_rows([(0, 20), (1, 20), (9, 20), (20, 20), (0, catches)])
        (track,) = results.compute(read(dataset(tmp_path / str(catches), rows={"1": rows}))).tasks[0].tracks
        fits.add(track.fit)
    assert [one.guess for one in fits if one] == [0]


def test_nobody_who_says_yes_to_every_catch_trial_has_a_fit(tmp_path: Path) -> None:
    rows = yes_no_rows([(9, 10), (10, 10), (10, 10), (10, 10), (4, 4)])
    (track,) = results.compute(read(dataset(tmp_path / "study", rows={"1": rows}))).tasks[0].tracks
    assert (track.guess, track.fit) == (1, None)


def test_catch_trials_alone_are_no_threshold_and_no_error(tmp_path: Path) -> None:
    root = dataset(tmp_path / "study", rows={"1": yes_no_rows([(0, 0)] * 4 + [(1, 4)])})
    assert palpate.detect(read(root)).to_frame().empty
    assert "thresholds.csv" in files(read(root))
    (asked, *_) = analyse([root], tmp_path / "out", figures=False).sections[0].asked
    assert len(asked.answer.split()) > 2


def test_pooled_sessions_keep_the_version_of_their_protocol_and_their_keys_may_differ(tmp_path: Path) -> None:
    keys = TABLES[1]["detection"] | {"yes_key": "8"}
    rows = {who: yes_no_rows([(2, 10), (4, 10), (9, 10), (10, 10), (3, 20)]) for who in "12"}
    north, south = dataset(tmp_path / "north"), dataset(tmp_path / "south", rows=rows, detection=keys)
    amended = TABLES[1] | {"study": TABLES[1]["study"] | {"title": "Amended"}}
    (north / "sourcedata" / "protocol-2.toml").write_text(tomlkit.dumps(amended), "utf-8")
    described = json.loads((north / "dataset_description.json").read_text("utf-8"))
    described["Palpate"]["Versions"] = [
        {"Protocol": file, "Sessions": [f"sub-{who}_task-one"]}
        for file, who in (("protocol.toml", "1"), ("protocol-2.toml", "2"))
    ]
    (north / "dataset_description.json").write_text(json.dumps(described), "utf-8")
    pooled = read_pooled([north, south])
    assert len(results.compute(pooled).tasks[0].tracks) == 4
    plans = [pooled.parts[0].plan(f"north-{who}", "one") for who in "12"]
    assert [one.study.title == "Amended" for one in plans if one] == [False, True]


def test_files_for_other_software_have_each_trial_of_each_track(tmp_path: Path) -> None:
    written = files(read(dataset(tmp_path / "study", 2)))
    rows = list(csv.DictReader(io.StringIO(written["tracks.csv"].decode())))
    assert [row["level"] for row in rows[:3]] == ["1.0", "1.0", "0.5"]
    assert sum(int(row["reversal"]) for row in rows) == 7
    # The sinusoid's peak of 3 m/s^2 at level 1.
    assert [float(row["peak_m_s2"]) for row in rows[:3]] == pytest.approx([3.0, 3.0, 1.5])
    (row,) = csv.DictReader(io.StringIO(written["thresholds.csv"].decode()))
    assert (row["signal"], row["method"]) == (SIGNAL, "reversals")


def test_the_library_has_a_row_for_each_track_and_the_folder_its_figures(analysed: Analysis) -> None:
    frame = palpate.detect(read(analysed.datasets[0])).to_frame()
    assert frame["participant"].to_list() == ["1", "2"]
    figures = {path.stem for path in (analysed.out / "figures").iterdir()}
    assert figures == {"functions"}


def test_a_dataset_without_its_protocol_is_refused(tmp_path: Path) -> None:
    root = dataset(tmp_path / "study")
    (root / "sourcedata" / "protocol.toml").unlink()
    with pytest.raises(DatasetError):
        results.compute(read(root))


@pytest.mark.parametrize(
    ("track", "beyond"),
    [("-" * 6 + "+-" * 6, "above the highest level"), ("+" * 30, "below the lowest level"), (TRACK, "")],
    ids=["top", "bottom", "between"],
)
def test_a_track_that_stays_at_an_end_of_its_levels_has_no_threshold(tmp_path: Path, track: str, beyond: str) -> None:
    root = dataset(tmp_path / "study", 2, rows={"1": two_rows(track)})
    found = results.compute(read(root))
    ((one,), (mean,)) = found.tasks[0].tracks, found.tasks[0].thresholds
    assert one.beyond == beyond
    assert (one.estimate.db is None, mean.by_rule is None, mean.fitted is None) == (bool(beyond),) * 3
    assert mean.beyond == ((("1", beyond),) if beyond else ())
    row = found.to_frame().iloc[0]
    assert (row["beyond"], bool(np.isnan(row["threshold_db"]))) == (beyond, bool(beyond))
    assert not beyond or beyond in " ".join(analyse([root], tmp_path / "out").write_up(10_000).split())


def test_guesses_have_the_limits_of_their_catch_trials(analysed: Analysis) -> None:
    """R 4.2.2: binom.test(2, 20) and binom.test(1, 20), $conf.int."""
    (task,) = analysed.results.tasks
    limits = [one.guess_limits for one in task.tracks]
    assert np.array(limits) == pytest.approx(np.array([(0.01234853, 0.3169827), (0.001265089, 0.2487328)]), rel=1e-6)


@pytest.mark.parametrize("which", ["analysed", "two"])
def test_the_text_says_how_levels_and_thresholds_came_about(
    which: str, request: pytest.FixtureRequest, approved: SnapshotAssertion
) -> None:
    found: Analysis = request.getfixturevalue(which)
    (procedure,) = (one for one in found.sections if one.slug == "procedure")
    assert "\n".join(procedure.paragraphs) == approved


def test_levels_that_no_answer_moves_have_no_track_drawn(analysed: Analysis, two: Analysis) -> None:
    drawn = [{path.stem for path in (one.out / "figures").iterdir()} for one in (analysed, two)]
    assert drawn == [{"functions"}, {"tracks", "functions"}]


@pytest.mark.parametrize(
    ("is_posterior", "stated"), [(True, ("-12.0 dB", "-10.0 dB")), (False, ("-10.0 dB", "-12.0 dB"))]
)
def test_the_threshold_that_errs_less_is_stated_first(is_posterior: bool, stated: tuple[str, str]) -> None:
    fitted, by_rule = mean(np.array([-11.0, -9.0])), mean(np.array([-13.0, -11.0]))
    words = detection._threshold_words(results.Threshold("tone", 1.0, fitted, by_rule, is_posterior))
    assert tuple(re.findall(r"-1\d\.0 dB", words)) == stated
