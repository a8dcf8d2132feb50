"""`palpate status`: how far a study is, without what is concealed. All data are SIMULATED."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections import Counter, namedtuple
from dataclasses import replace
from datetime import date
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment import storage
from palpate.experiment.dataset import build, checks
from palpate.experiment.dataset.checks import Plan
from palpate.experiment.dataset.status import Status, months_after, status
from palpate.experiment.errors import DatasetError, Remedy
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import chain
from palpate.experiment.study import privacy, withdrawal
from palpate.experiment.study.people import enrolling
from tests.conftest import Palpate
from tests.experiment.dataset.studies import DAY, MadeStudy, make_study
from tests.faults.wrong import copied


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> MadeStudy:
    """01 is done, 02 between tasks, 03 withdrew after one, 04 paused, 05 is erased, 06 and 07 are to begin."""
    study = make_study(tmp_path_factory.mktemp("made") / "study", enrolled=6, sessions=3, min_s=0)
    enrolling.enrol(study.file, "07", None, root=study.root, seed=None)
    first, paused, erased = study.tasks[0], study.tasks[3], study.tasks[4]
    study.run(study.header(first.participant, first.tasks[1]))
    study.run(study.header(paused.participant, paused.tasks[0]), "caq")
    study.run(study.header(erased.participant, erased.tasks[0]))
    for who in ("03", "05"):
        withdrawal.withdraw(study.file, who, "asked to stop", root=study.root, rebuild=build.build, erase=who == "05")
    build.build(study.root)
    return study


@pytest.fixture
def study(made: MadeStudy, tmp_path: Path) -> MadeStudy:
    return copied(made, tmp_path / "study")


def states(found: Status) -> dict[str, str]:
    return {one.participant: one.state for one in found.people}


def test_every_participant_has_one_state(made: MadeStudy) -> None:
    found = status(made.root, DAY)
    assert states(found) == {
        "01": "done",
        "02": "under way",
        "03": "withdrawn",
        "04": "under way",
        "05": "withdrawn",
        "06": "to begin",
        "07": "to begin",
    }
    assert (found.planned, found.erased, found.to_enrol, found.doubts) == (15, frozenset({"05"}), "08", ())
    assert [one.standing for one in found.those("under way")] == [
        "02 is between tasks; task 2 of 2 is next.",
        f"04, {made.tasks[3].tasks[0]} (task 1 of 2), is paused: 2 of 4 trials remain.",
    ]
    clock, reminder = found.reminders
    # The roster's lines are of today, which is later.
    assert str(DAY) in clock.what
    given = ("--participant", "07", "--consent-on", "DAY", "--dataset", str(made.root))
    assert isinstance(reminder.remedy, Remedy)
    assert reminder.remedy.command == ("palpate", "consent", str(storage.protocol_path(made.root)), *given)


def test_the_counts_by_order_are_those_who_began(made: MadeStudy) -> None:
    found = status(made.root, DAY).orders()
    began = Counter(made.tasks[place].tasks for place in (0, 1, 2, 3))
    assert {order: counts["begun"] for order, counts in found.items()} == began
    assert found[made.tasks[0].tasks]["done"] == 1
    assert found[made.tasks[2].tasks]["withdrawn"] == 1


@pytest.mark.parametrize("as_json", [False, True])
def test_the_order_of_who_has_not_begun_is_concealed(tmp_path: Path, palpate: Palpate, *, as_json: bool) -> None:
    """Under seeds that give 01 one order and the other, a study in which nobody has begun says the same."""
    said = set()
    firsts = set()
    for seed in range(1, 6):
        study = make_study(tmp_path / str(seed), seed=seed, sessions=0)
        firsts.add(study.tasks[0].tasks)
        code, out, _ = palpate("status", study.root, *["--json"] * as_json)
        assert code == 0
        said.add(out)
        assert not re.search("virtual|real,", out.replace("virtual and real", ""))
    assert (len(firsts), len(said)) == (2, 1)


def test_the_screen_is_one_of_80_columns(made: MadeStudy, palpate: Palpate) -> None:
    code, out, err = palpate("status", made.root)
    assert (code, err) == (0, "")
    wide = [line for line in out.splitlines() if len(line) > 80]
    assert [line.split()[:2] for line in wide] == [["palpate", "consent"]], "a command is never wrapped"
    assert len(out.splitlines()) <= 24
    assert "15 participants planned, 7 enrolled: 1 done, 2 under way, 2 to begin, 2" in out
    assert "06, task 1 of 2; the order of their tasks is concealed." in out
    # 03 withdrew from an order; 05, whose journals are gone, from none that is known.
    counted = {line[:34].strip(): line[34:].split() for line in out.splitlines()}
    assert counted["no session (erased or never begun)"] == ["0", "0", "1", "0", "0"]
    assert counted["all"] == ["4", "2", "2", "1", "0"]


def test_json_has_the_documented_keys(made: MadeStudy, palpate: Palpate, repository_root: Path) -> None:
    code, out, _ = palpate("status", made.root, "--json")
    document = json.loads(out)
    assert (code, document["due"], document["erased"], document["excluded"]) == (0, "06", ["05"], {})
    documented = (repository_root / "participants" / "README.md").read_text("utf-8")
    assert [key for key in document if f"`{key}`" not in documented] == []


def test_a_participant_whom_a_rule_excludes_is_counted_out(tmp_path: Path, palpate: Palpate) -> None:
    """The protocol wants four answered trials of each task, and one of this session has no answer."""
    study = make_study(tmp_path / "study", enrolled=1, sessions=0, min_s=0)
    for task in study.tasks[0].tasks:
        study.run(study.header("01", task), "canp")
    build.build(study.root)
    code, out, _ = palpate("status", study.root, "--json")
    document = json.loads(out)
    assert (code, document["done"], list(document["excluded"])) == (0, ["01"], ["01"])
    assert document["orders"][0]["excluded"] == 1


def test_a_session_without_an_end_is_told(study: MadeStudy) -> None:
    journal = study.journal(3)
    lines = journal.read_bytes().splitlines(keepends=True)
    kept = next(n for n, line in enumerate(lines) if b'"footer"' in line)
    journal.write_bytes(b"".join(lines[:kept]))
    found = status(study.root, DAY)
    assert states(found)["04"] == "doubted", "the head knows of the footer"
    assert len(found.doubts) == 1
    last = storage.read_bytes(journal).splitlines()[-1]
    journal.with_suffix(".head").write_text(f"{kept:012d} {hashlib.sha256(last).hexdigest()}\n")
    found = status(study.root, DAY)
    assert states(found)["04"] == "under way"
    told = [one.what for one in found.reminders]
    assert any("04: the session of task" in one and "palpate run continues it" in one for one in told)


def test_what_speaks_against_the_evidence_is_told_and_the_exit_code_is_1(study: MadeStudy, palpate: Palpate) -> None:
    study.journal(0).unlink()
    code, out, _ = palpate("status", study.root)
    assert code == 1
    assert "PROBLEMS IN THE DATA" in out
    assert "1 doubted" in out
    assert "Complete but excluded by the protocol's rules: not known." in out


@pytest.mark.parametrize(
    ("today", "said"),
    [
        (date(2098, 12, 1), None),
        (
            date(2098, 12, 2),
            "The approval ends on 2099-01-01; renew it, seal the protocol again, then run palpate amend.",
        ),
        (date(2099, 1, 2), "palpate seal PROTOCOL"),
    ],
)
def test_a_seal_that_ends_soon_is_told(made: MadeStudy, today: date, said: str | None) -> None:
    found = [told for one in status(made.root, today).reminders if "approv" in (told := one.sentence())]
    assert found == [] if said is None else len(found) == 1 and said in found[0]


def test_a_disk_that_is_nearly_full_is_told(made: MadeStudy, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = namedtuple("usage", "free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(999_999_999))
    assert "nearly full (1,000 MB free)" in status(made.root, DAY).reminders[-1].what


def test_a_protocol_file_leads_to_its_default_folder(study: MadeStudy, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(study.file.parent)
    with pytest.raises(
        DatasetError, match="participants/okamoto2012: does not contain a study; allowed: the dataset of a study"
    ):
        status(study.file, DAY)
    shutil.copytree(study.root, "participants/okamoto2012")
    assert states(status(study.file, DAY)) == states(status(study.root, DAY))
    study.file.write_text(study.file.read_text("utf-8").replace("min_s = 0", "min_s = 1"))
    assert any("dataset's version" in one.what for one in status(study.file, DAY).reminders)


def test_before_the_first_session_the_seal_is_beside_the_protocol(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study", sessions=0)
    (study.root / "sourcedata" / "protocol.seal.toml").unlink()
    found = status(study.root, DAY)
    assert found.seal.startswith("No session has begun, so this folder has no seal yet")
    assert (len(found.reminders), found.orders()) == (1, {})
    assert [name for name, _ in found.flow()[1]] == ["Enrolment", "Analysis"]


def test_a_pilot_says_so_first_and_a_reconstruction_is_no_study(tmp_path: Path, repository_root: Path) -> None:
    study = make_study(tmp_path / "study", pilot=True, sessions=1)
    assert status(study.root, DAY).text().startswith("PILOT - real participants, but not study data")
    with pytest.raises(
        DatasetError, match=r"okamoto2012: does not contain a study; .* it contains only counts from a publication"
    ):
        status(repository_root / "participants" / "okamoto2012", DAY)


def test_a_rehearsal_says_so_first_and_needs_no_seal(tmp_path: Path) -> None:
    kept, plan = storage.protocol_path(tmp_path), storage.plan_path(tmp_path)
    storage.write_bytes(kept, shipped("okamoto2012.toml").read_bytes())
    sha256 = approval.sha256(files.load(kept))
    planned = Plan(protocol_sha256=sha256, rig_sha256="0" * 64, participants=3, seed=1, control="none", real_time=False)
    storage.write_json(plan, planned.model_dump())
    found = status(tmp_path, DAY)
    assert states(found) == dict.fromkeys(("01", "02", "03"), "to begin")
    assert (found.planned, found.to_enrol, found.reminders) == (3, None, ())
    first, second, *_ = found.text().splitlines()
    assert first.startswith("REHEARSAL - simulated participants: okamoto2012: ")
    assert second == "A simulation needs no approval."


def test_the_flow_adds_up_and_puts_nobody_in_an_order_before_they_begin(made: MadeStudy) -> None:
    found = status(made.root, DAY)
    aside, stages = found.flow()
    assert aside.splitlines() == [
        "Not in any order below: n = 3",
        "to begin: 2",
        "withdrew before beginning: 0",
        "withdrew, data erased: 1",
    ]
    boxes = dict(stages)
    assert boxes["Enrolment"] == ("Enrolled: n = 7\n(planned: 15)",)
    began = [int(one.rsplit(" ", 1)[1]) for one in boxes["Allocation"]]
    ends = [
        sum(int(n) for n in re.findall(r"(?:completed|under way|withdrew): (\d+)", one)) for one in boxes["Sessions"]
    ]
    assert began == ends
    assert sum(began) == 4
    assert boxes["Analysis"] == ("Available for analysis: n = 1",)
    unknown = dict(replace(found, excluded=None).flow()[1])
    assert unknown["Analysis"] == ("Available for analysis: at most n = 1",)


@pytest.mark.parametrize(("name", "begins"), [("flow.svg", b"<?xml"), ("flow.PNG", b"\x89PNG"), ("flow.pdf", b"%PDF")])
def test_the_figure_is_drawn_alike_each_time(
    made: MadeStudy, palpate: Palpate, tmp_path: Path, name: str, begins: bytes
) -> None:
    drawn = []
    for _ in range(2):
        code, out, _ = palpate("status", made.root, "--figure", tmp_path / name)
        assert (code, out.splitlines()[-1]) == (0, f"Figure: {tmp_path / name}")
        drawn.append((tmp_path / name).read_bytes())
    assert drawn[0].startswith(begins)
    assert drawn[0] == drawn[1]


def test_a_figure_of_another_kind_is_refused(made: MadeStudy, palpate: Palpate, tmp_path: Path) -> None:
    code, out, err = palpate("status", made.root, "--figure", tmp_path / "flow.txt")
    assert (code, out) == (2, "")
    assert "got the suffix '.txt'; allowed: .svg, .png, .pdf" in err
    assert not (tmp_path / "flow.txt").exists()


@given(st.dates(date(1900, 1, 1), date(2200, 12, 31)), st.integers(1, 1200))
def test_months_are_counted_as_pandas_counts_them(day: date, months: int) -> None:
    wanted = pd.Timestamp(day) + pd.DateOffset(months=months)
    assert months_after(day, months) == wanted.date()


def test_no_day_comes_after_the_last_one() -> None:
    assert months_after(date(9999, 12, 31), 1) == date.max


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> MadeStudy:
    """01, 02 and 03 did a task on 2001-09-09, and 03 was erased; 04 only enrolled. Data are kept for 18 months."""
    study = make_study(tmp_path_factory.mktemp("kept") / "study", enrolled=4, sessions=3, kept_months=18)
    withdrawal.withdraw(study.file, "03", "asked to stop", root=study.root, rebuild=build.build, erase=True)
    build.build(study.root)
    return study


@pytest.mark.parametrize(
    ("today", "said"),
    [
        (date(2003, 2, 6), ()),
        (date(2003, 2, 7), ("The protocol allows data of participants 01, 02 to be kept until 2003-03-09",)),
        (date(2003, 3, 9), ("The protocol allows data of participants 01, 02 to be kept until 2003-03-09",)),
        (
            date(2003, 3, 10),
            ("OVERDUE: the protocol allowed data of participants 01, 02 to be kept only until 2003-03-09",),
        ),
    ],
)
def test_it_is_told_when_data_are_due_to_be_deleted(kept: MadeStudy, today: date, said: tuple[str, ...]) -> None:
    found = status(kept.root, today)
    reminders = [one for one in found.reminders if "to be kept" in one.what]
    assert [one.what[: len(start)] for one, start in zip(reminders, said, strict=True)] == list(said)
    assert all(isinstance(one.remedy, Remedy) and "--erase" in one.remedy.command for one in reminders)
    told = [one.sentence() for one in reminders]
    assert all("by hand" in one for one in told)
    assert found.as_dict()["keep_until"] == {"01": "2003-03-09", "02": "2003-03-09"}
    assert all(one in " ".join(found.text().split()) for one in told)


def test_where_the_protocol_states_no_time_none_is_told(made: MadeStudy) -> None:
    found = status(made.root, date(2099, 1, 1))
    assert (found.keep_until, [one for one in found.reminders if "kept" in one.what]) == ({}, [])


def test_an_older_roster_speaks_against_the_evidence(study: MadeStudy, palpate: Palpate) -> None:
    checks.keep_anchor(study.root)
    path = storage.roster_path(study.root)
    lines = path.read_bytes().splitlines(keepends=True)[:-1]
    path.write_bytes(b"".join(lines))
    last = hashlib.sha256(lines[-1].removesuffix(b"\n")).hexdigest()
    chain.head_path(path).write_text(f"{len(lines):012d} {last}\n", "utf-8")
    assert [(one.check, one.where) for one in status(study.root, DAY).doubts][:1] == [("anchors", path)]
    code, out, err = palpate("status", study.root)
    assert (code, err, "PROBLEMS IN THE DATA" in out) == (1, "", True)


def test_a_figure_replaces_a_figure_of_palpate_and_nothing_else(
    made: MadeStudy, tmp_path: Path, palpate: Palpate
) -> None:
    other = tmp_path / "thesis.svg"
    for kind in ("svg", "png", "pdf") * 2:
        assert palpate("status", made.root, "--figure", tmp_path / f"flow.{kind}")[0] == 0
    other.write_text("<svg>made with palpate</svg>", "utf-8")
    code, _, err = palpate("status", made.root, "--figure", other)
    assert (code, "not made by palpate" in err, other.read_text("utf-8")) == (
        2,
        True,
        "<svg>made with palpate</svg>",
    )


def test_what_others_can_read_is_a_reminder(made: MadeStudy, monkeypatch: pytest.MonkeyPatch) -> None:
    before = status(made.root, DAY).reminders
    monkeypatch.setattr(privacy, "readers_warning", lambda root: f"Others can read {root}.")
    after = status(made.root, DAY).reminders
    assert [one.what for one in after if one not in before] == [f"Others can read {made.root}."]
