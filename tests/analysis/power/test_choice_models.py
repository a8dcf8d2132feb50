"""Choice models: printed tables, datasets and files become shares and spreads, or an error says what is missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.analysis import published
from palpate.analysis.power import choice_models, planned_tests, simulate
from palpate.analysis.power.choice_models import Answers, ChoiceModel, draw
from palpate.experiment.errors import PowerError, ProtocolError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records.events import NO_ANSWER
from tests.analysis.datasets import trials, write_dataset
from tests.approved import Refuses

MATERIALS = ("copy paper", "aluminum foil", "polypropylene", "typing paper")

FILE = """format = 1
source = "a pilot"
""" + "".join(
    f"""
[[rows]]
task = "{task}"
presented = "{material}"
answers = [0.4, 0.3, 0.2, {last}]
spread = 0.1
"""
    for task, last in (("virtual", 0.1), ("real", 0.05))
    for material in MATERIALS
)


@pytest.fixture(scope="module")
def protocol() -> Protocol:
    return files.load(shipped("okamoto2012.toml"))


def test_print_gives_back_its_means_and_standard_deviations(protocol: Protocol, approved: SnapshotAssertion) -> None:
    """Okamoto, Tables 1 and 2: one spread a row makes the sum of its four variances that of the printed ones."""
    printed = published.load("okamoto2012")
    assert printed is not None
    model = simulate.find("published", protocol)
    cells = {(c.task, c.presented, c.answered): c for c in printed.tables()}
    for answers in model.tasks:
        people = {"virtual": 15, "real": 10}[answers.task]
        for i, shown in enumerate(MATERIALS):
            row = [cells[answers.task, shown, said] for said in MATERIALS]
            assert answers.shares[i, :4] == pytest.approx([c.mean.value for c in row], abs=0.004)
            p, q = answers.shares[i, :4], answers.spread[i] + (1 - answers.spread[i]) / 10
            # A sample's p (1 - p) is too small by variance / n, so that its variance is printed a little too large.
            printed_variance = sum(c.sd.value**2 for c in row if c.sd)
            assert (p * (1 - p)).sum() * q == pytest.approx(printed_variance * (1 - q / people), rel=1e-9)
    assert model.notes == approved
    assert "Table 1 and Table 2" in model.source


def test_a_fit_finds_the_model_that_made_the_data(tmp_path: Path, protocol: Protocol) -> None:
    truth = Answers("virtual", np.array([[0.6, 0.2, 0.1, 0.05, 0.05]] * 4), np.array([0.0, 0.1, 0.3, 0.6]))
    people = 400
    counts = draw(truth, trials=10, participants=people, studies=1, random=np.random.default_rng(3))[:, :, 0]
    said = (*MATERIALS, NO_ANSWER)
    sessions = {}
    for person in range(people):
        answers = [
            (shown, said[j]) for i, shown in enumerate(MATERIALS) for j in range(5) for _ in range(counts[i, j, person])
        ]
        sessions[f"{person:03d}"] = {"virtual": trials(answers), "real": trials(answers[:40])}
    root = write_dataset(tmp_path / "data", sessions, materials=MATERIALS, origin="REHEARSAL")
    model = simulate.find(str(root), protocol)
    assert [answers.task for answers in model.tasks] == ["virtual", "real"]
    assert model.tasks[0].shares == pytest.approx(truth.shares, abs=0.03)
    assert model.tasks[0].spread == pytest.approx(truth.spread, abs=0.05)
    assert "REHEARSAL" in model.source


def test_a_dataset_of_one_participant_has_no_spread(tmp_path: Path, protocol: Protocol, refuses: Refuses) -> None:
    rows = trials((shown, shown) for shown in MATERIALS)
    root = write_dataset(tmp_path / "data", {"01": {"virtual": rows, "real": rows}}, materials=MATERIALS)
    with refuses(PowerError):
        simulate.find(str(root), protocol)


def test_a_dataset_of_other_materials_lacks_these(tmp_path: Path, protocol: Protocol, refuses: Refuses) -> None:
    rows = trials([("glass", "glass"), ("sand", "snow")])
    root = write_dataset(tmp_path / "data", {"01": {"virtual": rows, "real": rows}})
    with refuses(PowerError):
        simulate.find(str(root), protocol)


def test_participants_less_apart_than_trials_make_them_have_no_spread(
    tmp_path: Path, protocol: Protocol, approved: SnapshotAssertion
) -> None:
    rows = trials([(shown, said) for shown in MATERIALS for said in MATERIALS])
    root = write_dataset(
        tmp_path / "data", {label: {"virtual": rows, "real": rows} for label in ("01", "02")}, materials=MATERIALS
    )
    model = simulate.find(str(root), protocol)
    assert not np.concatenate([answers.spread for answers in model.tasks]).any()
    assert model.notes[0] == approved


def test_a_file_is_taken_as_stated(tmp_path: Path, protocol: Protocol, approved: SnapshotAssertion) -> None:
    file = tmp_path / "pilot.toml"
    file.write_text(FILE, "utf-8")
    model = simulate.find(str(file), protocol)
    assert model.source == approved
    assert model.tasks[0].shares[0] == pytest.approx([0.4, 0.3, 0.2, 0.1, 0.0])
    assert model.tasks[0].shares[0, 4] == 0
    assert model.tasks[1].shares[2] == pytest.approx([0.4, 0.3, 0.2, 0.05, 0.05])
    assert np.all(model.tasks[1].spread == 0.1)


@pytest.mark.parametrize(
    ("old", "new", "error", "message"),
    [
        ("0.3, 0.2, 0.1]", "0.3, 0.9, 0.1]", ProtocolError, r"line 7: rows\[0\]\.answers: .*add up to at most 1"),
        ("0.3, 0.2, 0.1]", "0.3, 0.1]", PowerError, r"got 3 answers; allowed: 4, in the order of the protocol"),
        ("spread = 0.1", "spread = 1.0", ProtocolError, r"line 8: rows\[0\]\.spread: got 1\.0"),
        ('presented = "copy', 'presented = "soft', PowerError, r"got a row for task virtual, soft paper"),
        ('task = "virtual"', 'task = "real"', PowerError, r"got a row for task real, copy paper"),
        ("format = 1", "format = 2", ProtocolError, r"line 1: format: got 2; allowed: 1"),
        ("spread = 0.1", "sprawl = 0.1", ProtocolError, r"did you mean 'spread'"),
    ],
)
def test_a_bad_file_is_refused(
    tmp_path: Path, protocol: Protocol, old: str, new: str, error: type[Exception], message: str
) -> None:
    file = tmp_path / "pilot.toml"
    file.write_text(FILE.replace(old, new, 1), "utf-8")
    with pytest.raises(error, match=message):
        simulate.find(str(file), protocol)


def test_a_file_without_one_of_the_rows_is_refused(tmp_path: Path, protocol: Protocol, refuses: Refuses) -> None:
    file = tmp_path / "pilot.toml"
    file.write_text(FILE[: FILE.rindex("[[rows]]")], "utf-8")
    with refuses(PowerError):
        simulate.find(str(file), protocol)


def test_a_file_has_rows_of_what_each_task_presents(tmp_path: Path, protocol: Protocol, refuses: Refuses) -> None:
    tasks = (protocol.tasks[0].model_copy(update={"materials": MATERIALS[:2]}), protocol.tasks[1])
    some = protocol.model_copy(update={"tasks": tasks})
    file = tmp_path / "model.toml"
    file.write_text(FILE, "utf-8")
    with refuses(PowerError):
        choice_models.stated(file, some)
    head, *rows = FILE.split("[[rows]]")
    file.write_text("[[rows]]".join([head, *rows[:2], *rows[4:]]), "utf-8")
    virtual, real = choice_models.stated(file, some).tasks
    assert virtual.shares == pytest.approx(np.array([[0.4, 0.3, 0.2, 0.1, 0.0]] * 2 + [[0.0] * 5] * 2))
    assert (virtual.spread.tolist(), real.spread.tolist()) == ([0.1, 0.1, 0.0, 0.0], [0.1] * 4)


def test_guessing_is_chance(protocol: Protocol) -> None:
    model = simulate.find("okamoto2012", protocol)
    for answers, own in zip(model.control(protocol).tasks, model.tasks, strict=True):
        assert answers.shares[:, :4] == pytest.approx(np.full((4, 4), 0.25))
        assert not answers.shares[:, 4].any()
        assert answers.spread.tolist() == own.spread.tolist()


def test_a_study_without_print_has_no_published_model(protocol: Protocol, refuses: Refuses) -> None:
    own = protocol.model_copy(update={"study": protocol.study.model_copy(update={"id": "mine"})})
    with refuses(PowerError):
        simulate.find("published", own)
    assert simulate.find("okamoto2012", own).tasks[0].task == "virtual"


def test_print_that_lacks_a_material_says_which(protocol: Protocol, refuses: Refuses) -> None:
    other = protocol.materials[0].model_copy(update={"id": "silk"})
    own = protocol.model_copy(update={"materials": (other, *protocol.materials[1:])})
    with refuses(PowerError):
        simulate.find("published", own)


def test_print_that_adds_up_to_more_than_one_is_noted(
    tmp_path: Path, protocol: Protocol, approved: SnapshotAssertion
) -> None:
    """Polypropylene of Table 1, whose four means add up to 0.973 in print, with 0.65 set to 0.85: 1.173."""
    text = (Path(published.__file__).parent / "okamoto2012.toml").read_text(encoding="utf-8")
    old = 'mean = "0.65", sd = "0.27"'
    assert old in text
    file = tmp_path / "misprint.toml"
    file.write_text(text.replace(old, 'mean = "0.85", sd = "0.27"', 1), encoding="utf-8")
    model = choice_models.from_print(published.read(file), protocol)
    assert [note for note in model.notes if "add up to" in note] == approved
    assert model.tasks[0].shares[2, 2] == pytest.approx(0.85 / 1.173)


def test_print_without_participants_and_trials_has_no_spread(protocol: Protocol, refuses: Refuses) -> None:
    printed = published.load("okamoto2012")
    assert printed is not None
    with refuses(PowerError):
        choice_models.from_print(printed.model_copy(update={"task": ()}), protocol)


def test_a_published_study_of_another_kind_lacks_the_tasks(protocol: Protocol, refuses: Refuses) -> None:
    with refuses(PowerError):
        simulate.find("wellman1995", protocol)


def test_an_observer_of_two_numbers_is_as_often_right_and_as_unlike() -> None:
    """Beta-binomial variance (Skellam 1948): p (1 - p) m (1 + (m - 1) rho)."""
    protocol = files.load(shipped("okamoto2012.toml"))
    model = simulate.find("0.8,0.15", protocol)
    assert isinstance(model, ChoiceModel)
    drawn = model.drawn(planned_tests.design(protocol, {}), 15, 2000, np.random.default_rng(1))
    right = drawn["virtual"][2, 2]
    assert right.mean() == pytest.approx(8.0, abs=0.03)
    assert right.var() == pytest.approx(0.16 * 10 * (1 + 9 * 0.15), rel=0.03)
    for wrong in ("1.2,0.1", "0.8,1"):
        with pytest.raises(PowerError):
            simulate.find(wrong, protocol)


def test_a_control_differs_as_much_and_by_task_and_material() -> None:
    """As much in each cell as the model, with a correlation of the right share between tasks of one material."""
    protocol = files.load(shipped("okamoto2012.toml"))
    model = simulate.find("0.8,0.3", protocol).control(protocol)
    assert isinstance(model, ChoiceModel)
    drawn = model.drawn(planned_tests.design(protocol, {}), 15, 2000, np.random.default_rng(1))
    virtual, real = (drawn[task][range(4), range(4), :, :10] / 10 for task in ("virtual", "real"))
    assert virtual.mean() == pytest.approx(0.25, abs=0.003)
    assert virtual.var() == pytest.approx(0.1875 * (0.3 + 0.7 / 10), rel=0.02)
    same = np.corrcoef(virtual[0].ravel(), real[0].ravel())[0, 1]
    another = np.corrcoef(virtual[0].ravel(), real[1].ravel())[0, 1]
    within = np.corrcoef(virtual[0].ravel(), virtual[1].ravel())[0, 1]
    # Half, a quarter and a half of the spread, which is 0.3 / 0.37 of the variance, in common.
    assert same == pytest.approx(0.5 * 0.3 / 0.37, abs=0.04)
    assert another == pytest.approx(0.25 * 0.3 / 0.37, abs=0.04)
    assert within == pytest.approx(0.5 * 0.3 / 0.37, abs=0.04)
    assert (drawn["virtual"].sum(axis=1) == 10).all()


@pytest.mark.parametrize(("alike", "correlation"), [(0.0, 0.0), (1.0, 1.0), (0.5, None)])
def test_a_common_level_correlates_a_participants_tasks_and_leaves_each_as_it_was(
    protocol: Protocol, alike: float, correlation: float | None
) -> None:
    """Proportions of m trials have a variance of p (1 - p) (rho + (1 - rho) / m), of which the first part is shared."""
    right, spread, trials = 0.6, 0.2, 10
    planned, model = simulate.prepare(protocol, f"{right},{spread}", alike=alike)
    assert isinstance(model, ChoiceModel)
    drawn = model.drawn(planned, 15, 8000, np.random.default_rng(5))
    done = min(planned.sizes(15))
    one, other = (drawn[task.id][0, 0, :, :done].ravel() / trials for task in planned.tasks)
    level, whole = right * (1 - right) * spread, right * (1 - right) * (spread + (1 - spread) / trials)
    for each in (one, other):
        assert each.mean() == pytest.approx(right, abs=0.004)
        assert each.var() == pytest.approx(whole, rel=0.02)
    found = float(np.cov(one, other)[0, 1]) / level
    if correlation is None:
        # The normal scores are correlated by half; the shares of a beta by a little less.
        assert 0.45 < found < 0.5
    else:
        assert found == pytest.approx(correlation, abs=0.02)


def test_two_numbers_say_that_no_test_of_a_difference_can_find_one(protocol: Protocol) -> None:
    assert simulate.find("0.6,0.2", protocol).notes
    alone = protocol.model_copy(update={"analysis": protocol.analysis[:1]})
    assert alone.analysis[0].test == "t against chance"
    assert not simulate.find("0.6,0.2", alone).notes
