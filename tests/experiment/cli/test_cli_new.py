"""`palpate new`: questions with defaults, options for scripts, and nothing written unless all of it is."""

from __future__ import annotations

import tomllib
import wave
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.protocol import files
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.protocol.kinds.presented import Presented, Recorded
from tests.conftest import Palpate

Types = Callable[..., list[str]]


@pytest.fixture
def types(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Types:
    """Give these lines at the prompts, which are returned as they come; an exception is raised where it stands."""
    monkeypatch.chdir(tmp_path)

    def given(*answers: str | type[BaseException]) -> list[str]:
        asked: list[str] = []
        left: Iterator[str | type[BaseException]] = iter(answers)

        def read(prompt: str = "") -> str:
            asked.append(prompt)
            answer = next(left, EOFError)
            if isinstance(answer, str):
                return answer
            raise answer

        monkeypatch.setattr("builtins.input", read)
        return asked

    return given


def test_enter_takes_every_default(palpate: Palpate, types: Types, approved: SnapshotAssertion) -> None:
    asked = types(*[""] * 20)
    code, out, err = palpate("new")
    assert (code, err) == (0, "")
    assert [*asked, out] == approved
    assert [path.name for path in Path().iterdir()] == ["mystudy.toml"]
    assert palpate("check", "mystudy.toml")[0] == 0


def test_a_rig_alone_is_written_without_a_question(palpate: Palpate, types: Types) -> None:
    asked = types()
    code, out, err = palpate("new", "--rig", "ours")
    assert (code, err, asked, [path.name for path in Path().iterdir()]) == (0, "", [], ["ours.toml"])
    assert "ours.toml" in out
    assert rigs.load(Path("ours.toml")).rig.name == "ours"


def test_a_wrong_answer_is_told_and_asked_for_again(
    palpate: Palpate, types: Types, approved: SnapshotAssertion
) -> None:
    asked = types(
        "My Study", "five", "", "", "ten", "6", "felt, cork, Cork", "felt, cork", "n", "c", "f, cork", "", "x"
    )
    code, out, err = palpate("new")
    assert [*asked, out, err] == approved
    assert (code, list(Path().iterdir())) == (130, [])


@pytest.mark.parametrize("end", [KeyboardInterrupt, EOFError, OSError, RuntimeError])
@pytest.mark.parametrize("after", [0, 3, 9])
def test_an_interrupt_writes_nothing(palpate: Palpate, types: Types, end: type[BaseException], after: int) -> None:
    types(*[""] * after, end)
    code, _, err = palpate("new", "a.toml", "--rig", "r.toml")
    assert (code, "nothing was written" in err) == (130, True)
    assert list(Path().iterdir()) == []


def test_options_answer_every_question_without_a_terminal(
    palpate: Palpate, types: Types, approved: SnapshotAssertion
) -> None:
    asked = types()
    options = ["--id", "five", "--title", "Five", "--participants", 6, "--material", "felt, f, felt, cloth"]
    options += ["--material", "cork", "--tasks", "real", "--repetitions", 3, "--rig", "ours", "--yes"]
    code, out, err = palpate("new", "sub/a.toml", *options)
    assert (code, err, asked) == (0, "", [])
    made = files.load(Path("sub/a.toml"))
    assert (made.study.id, made.study.title, made.study.participants) == ("five", "Five", 6)
    assert [(one.id, one.key, one.spoken) for one in made.materials] == [
        ("felt", "f", ("felt", "cloth")),
        ("cork", "c", ("cork",)),
    ]
    assert [(task.id, task.repetitions) for task in made.tasks] == [("real", 3)]
    assert out == approved


@pytest.mark.parametrize(
    ("options", "refused"),
    [
        (["--participants", "0"], "got 0; allowed: a whole number at least 1"),
        (["--repetitions", "0"], "got 0; allowed: a whole number at least 1"),
        (["--repetitions", "-3"], "got '-3'; allowed: a whole number at least 1"),
        (["--id", "5"], "got '5'; allowed: up to 32"),
        (["--material", "felt"], "got 1 material; allowed: two materials or more"),
        (["--material", "", "--material", "cork"], "allowed: one line of 1 to 40 characters"),
        (["--rig", "x.txt"], "got the file 'x.txt'; allowed: a name that ends in .toml"),
        (["--rig", "a.toml"], "got 'a.toml' for both protocol and rig; allowed: a file for each"),
        (["--rig", "./a.toml"], "got 'a.toml' for both protocol and rig; allowed: a file for each"),
        (
            ["--rig", "-rig.toml"],
            "rig.name: got '-rig'; allowed: one line of 1 to 40 characters that starts with a letter",
        ),
        (
            ["--like", "okamoto2012", "--repetitions", "3"],
            "allowed: --id, --title, --participants, --answers, --recording and --factor; edit the copy to change",
        ),
        (["--like", "okamoto2012", "--id", "okamoto2012"], "got the id 'okamoto2012'; allowed: an id that differs"),
        (["--like", "none.toml"], "none.toml"),
        (["--like", "presented", "--kind", "presented"], "allowed: one of them"),
        (["--kind", "tapping", "--design", "rating"], "allowed: one of: footstep identification, presented"),
        (["--answers", "keys"], "got --answers, --recording or --factor for a footstep study"),
        (["--kind", "presented", "--recording", "none.wav"], "allowed: a WAV file"),
    ],
)
def test_an_option_that_cannot_be_taken_is_refused_and_writes_nothing(
    palpate: Palpate, types: Types, options: list[str], refused: str
) -> None:
    types()
    code, out, err = palpate("new", "a.toml", "--yes", *options)
    assert (code, out) == (2, "")
    assert refused in err
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize("there", ["a.toml", "r.toml"])
def test_no_file_is_overwritten_and_that_is_said_before_any_question(
    palpate: Palpate, types: Types, there: str, approved: SnapshotAssertion
) -> None:
    asked = types()
    Path(there).write_text("precious")
    code, _, err = palpate("new", "a", "--rig", "r")
    assert (code, asked) == (2, [])
    assert err == approved
    assert [(path.name, path.read_text()) for path in Path().iterdir()] == [(there, "precious")]


def test_an_id_whose_file_exists_and_a_rig_without_a_name_are_asked_for_again(
    palpate: Palpate, types: Types, approved: SnapshotAssertion
) -> None:
    types("", "other", *[""] * 10, "_rig", "")
    Path("mystudy.toml").write_text("precious")
    code, out, _ = palpate("new")
    assert code == 0
    assert out == approved
    assert sorted(path.name for path in Path().iterdir()) == ["mystudy.toml", "other.toml"]


def test_a_protocol_that_comes_with_palpate_is_copied_under_another_id(
    palpate: Palpate, types: Types, approved: SnapshotAssertion
) -> None:
    asked = types(*[""] * 5)
    code, _, err = palpate("new", "my-study.toml", "--like", "okamoto2012")
    assert (code, err) == (0, "")
    assert asked == approved
    made, source = files.load(Path("my-study.toml")), files.load(files.shipped("okamoto2012.toml"))
    expected = source.model_copy(update={"study": source.study.model_copy(update={"id": "mystudy"})})
    assert made.model_dump() == expected.model_dump()


@pytest.mark.parametrize("design", ["identification", "detection", "comparison", "rating"])
def test_a_study_of_presented_stimuli_begins_from_that_of_its_design(
    palpate: Palpate, types: Types, design: str
) -> None:
    types()
    options = ["--kind", "presented", "--design", design, "--participants", 5, "--answers", "screen", "--yes"]
    assert palpate("new", "mine.toml", *options)[0] == 0
    made = files.load(Path("mine.toml"))
    assert (made.study.id, made.study.participants, made.answers.mode) == ("mine", 5, "screen")
    assert {(one.kind, one.design, one.participants) for one in made.tasks} == {("presented", design, 5)}


def test_recorded_waveforms_to_be_told_apart_stand_beside_their_study(palpate: Palpate, types: Types) -> None:
    types()
    for name in ("felt", "cork", "foil"):
        with wave.open(f"{name}.wav", "wb") as file:
            file.setparams((1, 2, 8000, 0, "NONE", ""))
            file.writeframes(name.encode() * 1000)
    options = ["--kind", "presented", "--answers", "keys", "--full-scale", 20, "--yes"]
    options += [part for name in ("felt", "cork", "foil") for part in ("--recording", f"{name}.wav")]
    assert palpate("new", "sub/three.toml", *options)[0] == 0
    made = files.load(Path("sub/three.toml"))
    waves = [one.parts[0].wave[1] for one in made.table(Presented).stimuli]
    assert [(one.file, one.full_scale_m_s2, one.lasts_s) for one in waves if isinstance(one, Recorded)] == [
        ("felt.wav", 20, 0.25),
        ("cork.wav", 20, 0.25),
        ("foil.wav", 20, 0.25),
    ]
    assert [one.key for one in made.materials] == ["1", "2", "3"]
    assert Path("sub/cork.wav").read_bytes() == Path("cork.wav").read_bytes()
    Path("sub/foil.wav").write_bytes(b"precious")
    assert palpate("new", "sub/four.toml", *options)[0] == 2


def test_a_copy_has_as_many_participants_as_asked_and_a_smaller_task_no_more_than_before(
    palpate: Palpate, types: Types
) -> None:
    types()
    assert palpate("new", "mine", "--like", "okamoto2012", "--id", "mine", "--participants", 12, "--yes")[0] == 0
    made = files.load(Path("mine.toml"))
    assert (made.study.participants, [one.participants for one in made.tasks]) == (12, [12, 10])


def test_a_new_rig_is_one_that_says_what_is_to_be_measured(palpate: Palpate, types: Types) -> None:
    types()
    palpate("new", "a", "--rig", "our rig.toml", "--yes")
    rig = rigs.load(Path("our rig.toml"))
    assert (rig.rig.name, rig.rig.simulated) == ("our rig", False)
    rigs.check(rig, files.load(Path("a.toml")).table(Footstep).step)
    text = Path("our rig.toml").read_text("utf-8")
    assert text.count("NOT CALIBRATED") + text.count("NOT MEASURED") == 4
    assert tracker_of(rig).calibrated_on is None
    assert tomllib.loads(text) == {
        **tomllib.loads(files.shipped("rigs/laboratory.toml").read_text("utf-8")),
        "rig": {"name": "our rig", "simulated": False},
    }


@pytest.mark.parametrize("of", [["--kind", "footstep"], ["--kind", "presented"], ["--design", "detection"]])
def test_a_training_stands_before_the_trials_of_each_task_and_lengthens_the_session(
    palpate: Palpate, types: Types, of: list[str]
) -> None:
    types()
    assert palpate("new", "plain.toml", *of, "--id", "one", "--yes")[0] == 0
    assert palpate("new", "a.toml", *of, "--id", "one", "--training", 20, "--yes")[0] == 0
    plain, made = files.load(Path("plain.toml")), files.load(Path("a.toml"))
    trainings = [task.training for task in made.tasks]
    assert [(one and one.trials, one and one.feedback) for one in trainings] == [(20, True)] * len(plain.tasks)
    assert made.duration
    assert plain.duration
    assert made.duration.shortest_min > plain.duration.shortest_min
    assert palpate("check", "a.toml")[0] == 0


def test_a_training_is_refused_where_no_answer_is_right_and_without_trials(palpate: Palpate, types: Types) -> None:
    types()
    for design, trials in ("rating", 20), ("identification", 0):
        kind = ["--kind", "presented", "--design", design]
        code, _, err = palpate("new", "a.toml", *kind, "--training", trials, "--yes")
        assert (code, f"--training {trials}" in err, list(Path().iterdir())) == (2, True, [])
