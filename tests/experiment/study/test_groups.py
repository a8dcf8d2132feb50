"""Groups into which participants are drawn: balanced, with the orders of tasks in each; on the roster, and kept."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment import storage
from palpate.experiment.dataset import build, checks
from palpate.experiment.dataset.outside import sharing
from palpate.experiment.dataset.status import status
from palpate.experiment.dataset.verify import verify
from palpate.experiment.desk.questions import Console
from palpate.experiment.errors import DatasetError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.session import visit
from palpate.experiment.settings import load
from palpate.experiment.study import amendment, enrolment, withdrawal
from palpate.experiment.study.people import enrolling
from palpate.experiment.study.roster import Roster
from palpate.experiment.study.schedule import allocate, allocated
from tests.experiment.dataset.studies import DAY, MadeStudy, make_study
from tests.experiment.protocol.asking import asking
from tests.experiment.protocol.small import changed, document
from tests.experiment.study.test_allocation import study as small
from tests.experiment.study.test_approvals import seal_again

GROUPS = """[[groups]]
id = "trained"
description = "They practice for 20 min before the first task."

[[groups]]
id = "not trained"
description = "They rest for 20 min before the first task."
"""

DRAWN: Any = tuple({"id": name, "description": f"Group {name}."} for name in ("b", "a", "c"))


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_study(tmp_path_factory.mktemp("groups") / "study", enrolled=4, further=asking(GROUPS)).file.parent


@pytest.fixture
def study(original: Path, tmp_path: Path) -> MadeStudy:
    folder = shutil.copytree(original, tmp_path / "study")
    return MadeStudy(folder / "study.toml", folder / "dataset")


def known(study: MadeStudy) -> dict[str, str]:
    return Roster.load(storage.roster_path(study.root)).groups


@given(st.integers(), st.integers(1, 40))
def test_groups_balance_after_every_block_and_orders_within_each(seed: int, people: int) -> None:
    protocol = small(people, {"one": people, "two": people}).model_copy(update={"groups": ProtocolFile.model_validate(
        {**changed(document(), ("format",), 7), "groups": DRAWN}).groups})  # type: ignore[attr-defined]  # fmt: skip
    found = allocate(protocol, seed)
    for begin in range(0, people - 2, 3):
        assert {one.group for one in found[begin : begin + 3]} == {"a", "b", "c"}
    for begin in range(0, people - 5, 6):
        own = Counter((one.group, one.tasks) for one in found[: begin + 6])
        assert max(own.values()) - min(own.values()) == 0
        assert len(own) == 6


def test_a_study_without_groups_has_the_orders_that_it_had() -> None:
    found = allocate(small(12, {"a": 12, "b": 12}), 1)
    # Printed by commit 9e17ffaa, which had no groups.
    assert [one.tasks[0] for one in found] == list("baababbaabab")
    assert {one.group for one in found} == {""}


def test_the_group_stands_on_the_line_of_the_roster_and_whoever_replaces_somebody_has_theirs(study: MadeStudy) -> None:
    lines = [json.loads(line)["entry"] for line in storage.roster_path(study.root).read_text("utf-8").splitlines()]
    assert [one["group"] for one in lines if one["kind"] in ("first", "enrolled")] == [*known(study).values()]
    assert Counter(known(study).values()) == {"trained": 2, "not trained": 2}
    seed = enrolment.seed_of(study.root)
    withdrawal.withdraw(study.file, "03", "asked to stop", root=study.root, rebuild=build.build)
    for place in range(5, 17):
        enrolling.enrol(study.file, f"{place:02d}", DAY, root=study.root, seed=None)
    roster = Roster.load(storage.roster_path(study.root))
    assert roster.takes == {"16": "03"}
    assert roster.groups["16"] == roster.groups["03"]
    assert roster.groups == {one.participant: one.group for one in allocated(study.protocol, seed, roster.takes)}


def test_tables_and_status_have_groups(study: MadeStudy) -> None:
    build.build(study.root)
    rows = checks.table_rows(study.root / "participants.tsv")[:-1]
    assert {row["participant_id"].removeprefix("sub-"): row["group"] for row in rows}.items() <= known(study).items()
    described = json.loads((study.root / "participants.json").read_text("utf-8"))["group"]
    assert [*described["Levels"]] == ["trained", "not trained"]
    found = status(study.root, DAY)
    assert {name: counts.total() for name, counts in found.groups().items()} == {"not trained": 2, "trained": 2}
    assert found.as_dict()["groups"] == found.groups()
    assert verify(study.root).refused == 0


def test_another_group_than_was_drawn_is_refused(study: MadeStudy) -> None:
    loaded = checks.load(study.root)
    dataset = replace(loaded, groups=dict.fromkeys(loaded.groups, "trained"))
    refused = [one for one in checks.findings(dataset, "participants") if one.refuses]
    assert len(refused) == list(known(study).values()).count("not trained")


def test_an_amendment_keeps_groups(study: MadeStudy) -> None:
    text = study.file.read_text("utf-8")
    study.file.write_text(text.replace('id = "trained"', 'id = "practiced"'), "utf-8")
    seal_again(study)
    with pytest.raises(DatasetError, match="ids of groups"):
        amendment.plan_approval(study.file, root=study.root, in_progress="old", reconsent=False)
    study.file.write_text(text.replace("They rest for 20 min", "They rest for 30 min"), "utf-8")
    seal_again(study)
    planned = amendment.plan_approval(study.file, root=study.root, in_progress="old", reconsent=False)
    amendment.record(study.file, planned, root=study.root)
    assert checks.load_sound(study.root).groups.items() >= known(study).items()


@pytest.mark.parametrize(
    ("groups", "field"),
    [
        (DRAWN, None),
        (DRAWN[:1], "groups"),
        ((*DRAWN, {"id": "A", "description": "Again."}), "groups[3].id"),
        ((*DRAWN, {"id": "NA", "description": "Missing."}), "groups[3].id"),
    ],
)
def test_groups_are_two_or_more_with_names_of_their_own(groups: Any, field: str | None) -> None:
    found = load.find(ProtocolFile, {**changed(document(), ("format",), 7), "groups": groups}, {})
    assert [one.field for one in found] == ([field] if field else [])


def test_a_copy_for_others_has_groups_which_count_in_the_smallest(tmp_path: Path) -> None:
    further = asking(GROUPS, '[sharing]\nstatement = "May your trials be shared?"\nsmallest_group = 1\n')
    study = make_study(tmp_path / "study", enrolled=4, sessions=4, further=further)
    described = study.root / "dataset_description.json"
    described.write_text(json.dumps({**json.loads(described.read_text("utf-8")), "License": "CC0-1.0"}), "utf-8")
    for label in known(study):
        enrolling.sharing(study.file, label, True, root=study.root)
    copy = sharing.share(study.root, tmp_path / "copy")
    rows = checks.table_rows(copy.root / "participants.tsv")[:-1]
    assert Counter(row["group"] for row in rows) == {"trained": 2, "not trained": 2}
    assert copy.smallest_group == 1
    assert len({(row["group"], row["first_task"]) for row in rows}) == 4


def test_whoever_practices_is_told_of_the_group(original: Path) -> None:
    protocol, told = files.load(original / "study.toml"), list[object]()
    for one in allocate(protocol, 1):
        visit.tell_group(cast("Console", SimpleNamespace(tell=told.append)), protocol, one)
    groups = ("They rest for 20 min", "They practice for 20 min")
    assert sorted(Counter(any(words in str(one) for words in groups) for one in told).items()) == [(True, len(told))]
    assert len(told) == protocol.study.participants
