"""A new protocol is accepted and holds what was answered; what refuses an answer is what would refuse the file."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.errors import PalpateError, ProtocolError
from palpate.experiment.protocol import approval, files, new
from palpate.experiment.protocol.approval import sealing
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.new import models
from palpate.experiment.protocol.page import page
from tests.approved import Refuses
from tests.experiment.protocol.small import OKAMOTO2012, SMALL

FIVE = new.materials(("felt", "cork", "kraft paper", "foil", "film"))


def written(study: new.NewStudy, folder: Path) -> tuple[Path, Protocol]:
    file = folder / "mystudy.toml"
    file.write_text(new.text(study), "utf-8")
    return file, files.load(file)


@pytest.mark.parametrize("tasks", new.TASKS)
@pytest.mark.parametrize("count", [2, 3, 5])
@pytest.mark.parametrize("repetitions", [1, 10, 1000])
def test_a_new_study_is_a_protocol_that_holds_what_was_answered(
    tmp_path: Path, tasks: str, count: int, repetitions: int
) -> None:
    study = new.NewStudy("five", "Told apart", 7, FIVE[:count], tasks, repetitions)
    _, made = written(new.checked(study), tmp_path)
    assert (made.study.id, made.study.title, made.study.participants) == ("five", "Told apart", 7)
    assert [(one.id, one.key, one.spoken) for one in made.materials] == [
        (m.name, m.key, m.spoken) for m in FIVE[:count]
    ]
    assert [task.id for task in made.tasks] == list(new.TASKS[tasks])
    assert {(task.participants, task.repetitions, task.stimulus == task.id) for task in made.tasks} == {
        (7, repetitions, True)
    }
    assert [test.chance for test in made.analysis if test.chance is not None] == [pytest.approx(1 / count)]
    assert len(made.analysis) == len(made.tasks)


def test_every_table_and_key_has_a_comment_beside_or_above_it() -> None:
    # A key without one stands in a table or beside keys that the comment above it tells of.
    blocks = new.text(new.NewStudy()).split("\n\n")
    told = ("study", "materials", "exclusion", "analysis")
    bare = [one for one in blocks if "=" in one and "#" not in one and not re.match(rf"\[+({'|'.join(told)})", one)]
    assert bare == []
    lines = new.text(new.NewStudy()).splitlines()
    assert max(len(line) for line in lines if not line.startswith("instruction")) <= 120


def test_the_duration_is_that_of_the_published_study_for_its_trials() -> None:
    # Section 5 of Okamoto et al.: 60 to 80 min for two tasks of 40 trials; section 5.1: 3 to 5 min before each.
    made = ProtocolFile.model_validate(tuples(tomllib.loads(new.text(new.NewStudy()))))
    assert made.duration is not None
    assert made.duration.shortest_min <= 60 <= 80 <= made.duration.longest_min


def test_the_planned_test_adjusts_p_as_its_question_says() -> None:
    (against_chance, *_) = tomllib.loads(new.text(new.NewStudy()))["analysis"]
    assert "P adjusted by Holm" in " ".join(against_chance["question"].split())
    assert against_chance["correction"] == "materials"


def tuples(value: object) -> object:
    if isinstance(value, dict):
        return {key: tuples(held) for key, held in value.items()}
    return tuple(map(tuples, value)) if isinstance(value, list) else value


def test_what_is_to_be_filled_in_stands_on_the_page_and_is_not_sealed(tmp_path: Path, refuses: Refuses) -> None:
    file, made = written(new.NewStudy(materials=FIVE[:2]), tmp_path)
    wanted = ["study.source", "ethics.board", "ethics.statement", *(f"materials[{i}].description" for i in range(2))]
    assert list(sealing.unfilled(made)) == wanted
    _, left = page(made, str(file)).split("12. Left for the laboratory")
    assert [name for name in wanted if f"  - {name}\n" in left] == wanted
    days: dict[str, Any] = {"approved_on": date(2026, 1, 1), "expires_on": date(2027, 1, 1)}
    with refuses(ProtocolError):
        sealing.write(file, made, approval_number="1", board=made.ethics.board, **days)
    assert not approval.seal_path(file).exists()
    file.write_text(file.read_text("utf-8").replace(f"{sealing.UNFILLED}: ", ""), "utf-8")
    filled = files.load(file)
    assert sealing.write(file, filled, approval_number="1", board=filled.ethics.board, **days)


def test_keys_are_letters_of_the_name_that_nothing_else_has() -> None:
    # n, r and q stand for no answer, redo and pause.
    found = new.materials(["nylon", "rubber", "rubber mat", "NRQ", "\u7d19", "felt,y", "silk,&,silk,satin"])
    assert [one.key for one in found] == ["l", "u", "b", "a", "c", "y", "&"]
    assert [one.spoken for one in found[-2:]] == [("felt",), ("silk", "satin")]
    assert new.materials(["a"] * 70)[-1].key == new.NO_ANSWER


def test_the_key_of_one_material_leaves_another_to_those_after_it(refuses: Refuses) -> None:
    study = new.NewStudy(materials=new.materials(["cork", "copper", "felt"]))
    assert [one.key for one in study.materials] == ["c", "o", "f"]
    study = new.with_material(study, 0, "o, cork, stopper")
    assert [one.typed for one in study.materials] == ["o, cork, stopper", "c, copper", "f, felt"]
    with refuses(PalpateError):
        new.with_material(study, 1, "o")


@pytest.mark.parametrize(
    ("change", "refused"),
    [
        ({"id": "My study"}, "got 'My study'; allowed: up to 32 lowercase letters and digits, starting with a letter"),
        ({"id": ""}, "allowed: up to 32"),
        ({"title": " "}, "got ' '; allowed: text, not blank"),
        ({"title": "a\x7f\x1b"}, "with U\\+007F, U\\+001B; allowed: text, not blank"),
        ({"participants": 0}, "got 0; allowed: a whole number at least 1 and at most 10000"),
        ({"repetitions": 1001}, "got 1001; allowed: a whole number at least 1 and at most 1000"),
        ({"tasks": "neither"}, "got 'neither'; allowed: one of: virtual, real, both"),
        ({"materials": FIVE[:1]}, "got 1 material; allowed: two materials or more$"),
        ({"materials": ()}, "got 0 materials; allowed: two materials or more$"),
        (
            {"materials": new.materials(["felt", "Felt"])},
            "got 'Felt'; allowed: a unique name: 'felt' already has this value$",
        ),
        (
            {"materials": new.materials(["felt,n", "cork"])},
            "got the key 'n', which is already used for 'no answer'; allowed: a unique key$",
        ),
        (
            {"materials": new.materials(["felt,x", "cork,x"])},
            "got 'x'; allowed: a unique key: 'felt' already has this value$",
        ),
        (
            {"materials": new.materials(["felt,f", "cork,c,felt"])},
            "got 'felt'; allowed: a unique phrase: 'felt' already has this name$",
        ),
        ({"materials": new.materials(["felt,+", "cork"])}, "any key except \\+ and -"),
    ],
)
def test_what_would_refuse_the_file_refuses_the_answer_in_one_line(change: dict[str, object], refused: str) -> None:
    with pytest.raises(PalpateError, match=refused) as told:
        new.checked(replace(new.NewStudy(), **change))  # type: ignore[arg-type]
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("typed", ["ten", "-1", "1.5", "", "\u0663", "1" * 40, "0x10"])
def test_what_is_no_whole_number_is_told_as_the_field_is(typed: str, refuses: Refuses) -> None:
    with refuses(PalpateError):
        new.whole(typed, ("study", "participants"))


@given(st.lists(st.text(max_size=12), min_size=2, max_size=4), st.text(max_size=20))
def test_any_answer_is_held_as_it_is_or_refused(names: list[str], title: str) -> None:
    study = new.NewStudy(title=title, materials=new.materials(names))
    try:
        new.checked(study)
    except PalpateError:
        return
    made = ProtocolFile.model_validate(tuples(tomllib.loads(new.text(study))))
    assert made.study.title == title
    assert [(one.id, one.spoken) for one in made.materials] == [(one.name, one.spoken) for one in study.materials]


def test_a_copy_differs_from_the_published_study_in_its_id_alone() -> None:
    before = OKAMOTO2012.read_text("utf-8")
    assert models.copied(OKAMOTO2012, "mine") == before.replace('id = "okamoto2012"', 'id = "mine"', 1)
    titled = tomllib.loads(models.copied(OKAMOTO2012, "mine", "Mine"))
    assert titled == {**tomllib.loads(before), "study": {**titled["study"], "id": "mine", "title": "Mine"}}


@pytest.mark.parametrize("study_id", ["okamoto2012", "Mine", ""])
def test_a_copy_has_an_id_of_its_own(study_id: str) -> None:
    with pytest.raises(PalpateError, match=f"got (the id )?'{study_id}'; allowed: "):
        models.copied(OKAMOTO2012, study_id)


def test_a_copy_has_no_approval(tmp_path: Path) -> None:
    file = tmp_path / "small.toml"
    file.write_text(SMALL.replace("[duration]", 'approval_number = "17"\n\n[duration]'), "utf-8")
    file.with_name("copy.toml").write_text(models.copied(file, "copy"), "utf-8")
    made, source = files.load(file.with_name("copy.toml")), files.load(file)
    ethics = source.ethics.model_copy(update={"approval_number": "", "approved_on": None, "expires_on": None})
    assert made == source.model_copy(update={"ethics": ethics, "study": source.study.model_copy(update={"id": "copy"})})


def test_a_new_file_ends_in_toml_and_stands_in_nobodys_way(tmp_path: Path, refuses: Refuses) -> None:
    assert new.free(tmp_path / "mystudy") == new.free(tmp_path / "mystudy.toml") == tmp_path / "mystudy.toml"
    for name in ("study.seal.toml", "study.txt"):
        with pytest.raises(PalpateError, match=r"allowed: a name that ends in \.toml but not in \.seal\.toml"):
            new.free(tmp_path / name)
    (tmp_path / "mystudy.toml").symlink_to(tmp_path / "nowhere")
    with refuses(PalpateError):
        new.free(tmp_path / "mystudy")


def test_a_copy_may_have_other_values_of_factors(refuses: Refuses) -> None:
    timing = files.shipped("timing.toml")
    changed = models.Changes(values=models.values(["delay=-20,0,15.5"]))
    (delay,) = tomllib.loads(models.copied(timing, "mine", changed=changed))["factors"]
    assert delay["values"] == [-20.0, 0.0, 15.5]
    assert "names" not in delay
    with refuses(PalpateError):
        models.copied(timing, "mine", changed=models.Changes(values={"pitch": (1.0, 2.0)}))


def test_values_of_a_factor_are_numbers(refuses: Refuses) -> None:
    with refuses(PalpateError):
        models.values(["delay=soon"])
