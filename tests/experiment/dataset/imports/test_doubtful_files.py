"""What files of trials leave open: who is one person, what is practice, which unit, session or spelling is meant."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from palpate.experiment.dataset.imports.imported import Imported, import_trials
from palpate.experiment.dataset.imports.layout import Layout, cells, pairs
from palpate.experiment.dataset.imports.trial_files import Trials, read_trials
from palpate.experiment.errors import DatasetError, Finding, Remedy
from palpate.experiment.settings.delimited import Stated

PLAIN = Layout("shown", "said", "who")
COMMAND = Stated(command=("palpate", "import-trials"))


def _file(tmp_path: Path, text: str, name: str = "trials.csv") -> Path:
    path = tmp_path / name
    path.write_text(text, "utf-8", newline="")
    return path


def _read(tmp_path: Path, text: str, layout: Layout = PLAIN) -> Trials:
    return read_trials([_file(tmp_path, text)], layout, (), COMMAND)


def _made(tmp_path: Path, *texts: str, layout: Layout = PLAIN, out: str = "out") -> Imported:
    paths = [_file(tmp_path, text, f"{n}.csv") for n, text in enumerate(texts)]
    return import_trials(paths, tmp_path / out, layout, study="lab", source="made", stated=COMMAND)


def _added(finding: Finding) -> tuple[str, ...]:
    """Return what the remedy adds to the command."""
    assert isinstance(finding.remedy, Remedy)
    return finding.remedy.command[2:]


def _people(*names: str) -> str:
    return "who,shown,said\n" + "".join(f'"{name}",felt,cork\n"{name}",cork,cork\n' for name in names)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("M\u00fcller", "Mueller"),
        ("Muller", "M\u00fcller"),
        ("Mu\u0308ller", "MUELLER"),
        ("J\u00f6rg", "Joerg"),
        ("Gro\u00df", "gross"),
        ("S\u00f8ren", "Soren"),
        ("Jos\u00e9", "Jose"),
        ("Anna Meier", "Anna-Meier"),
        ("Anna Meier", "Meier Anna"),
        ("Anna.Meier", "Meier, Anna"),
        ("anna_meier", "AnnaMeier"),
        ("P-02", "P02"),
        ("P_2", "2"),
        ("P02", "2"),
    ],
)
def test_one_person_under_two_spellings_is_asked_about(tmp_path: Path, one: str, other: str) -> None:
    """They are one person with the remedy, and two where the one is mapped to itself."""
    text = _people(one, other, "Zoe")
    with pytest.raises(DatasetError) as refused:
        _made(tmp_path, text)
    option, mapping = _added(refused.value.finding)
    assert (option, mapping) == ("--map-participant", f"{other}={one}")
    made = _made(tmp_path, text, layout=replace(PLAIN, people=pairs(option, [mapping])))
    assert made.sentences[0].startswith("Participants: 2.")
    made = _made(tmp_path, text, layout=replace(PLAIN, people={other: other}), out="two")
    assert made.sentences[0].startswith("Participants: 3.")


def test_labels_that_differ_are_not_asked_about(tmp_path: Path) -> None:
    names = ("1-12", "11-2", "A1 B2", "A2 B1", "B1 A2", "AB", "BA", "Anna", "Hanna", "X2", "Y2", "Samuel", "Samul")
    assert _made(tmp_path, _people(*names)).sentences[0].startswith(f"Participants: {len(names)}.")


def test_all_spellings_are_asked_about_with_one_command(tmp_path: Path) -> None:
    with pytest.raises(DatasetError) as refused:
        _made(tmp_path, _people("Jos\u00e9", "Anna Meier", "Jose", "Meier-Anna"))
    options = ("--map-participant", "Jose=Jos\u00e9", "--map-participant", "Meier-Anna=Anna Meier")
    assert _added(refused.value.findings[-1]) == options


@pytest.mark.parametrize(
    ("column", "practice", "main", "added"),
    [
        ("phase", "practice", "main", ("--leave-out", "phase=practice")),
        ("block", "Training 1", "1", ("--leave-out", "block=Training 1")),
        ("part", "warm-up", "test", ("--leave-out", "part=warm-up")),
        ("is_practice", "True", "False", ("--leave-out", "is_practice=True")),
        ("practice.thisN", "0", "", ("--leave-out", "practice.thisN=*")),
        ("teil", "\u00dcbung", "Messung", ("--leave-out", "teil=\u00dcbung")),
    ],
)
def test_practice_among_trials_is_a_caution_and_can_be_left_out(
    tmp_path: Path, column: str, practice: str, main: str, added: tuple[str, ...]
) -> None:
    rows = "".join(f"1,felt,cork,{cell}\n1,cork,cork,{cell}\n" for cell in (practice, main, main))
    text = f"who,shown,said,{column}\n{rows}"
    made = _made(tmp_path, text)
    (doubt,) = made.doubts
    assert (doubt.verdict, doubt.check, doubt.field, _added(doubt)) == ("warns", "practice", f"column {column}", added)
    assert doubt.what.split()[:3] == ["2", "of", "6"]
    assert f"CAUTION: column {column}:" in " ".join((made.root / "README").read_text().split())
    without = _made(tmp_path, text, layout=replace(PLAIN, leave_out=cells(added[1::2])), out="without")
    assert (without.doubts, without.sentences[0].split(". ")[1].split(",")[0]) == ((), "Trials: 4")
    assert sum("left out" in sentence for sentence in without.sentences) == 1


def test_a_group_that_is_called_training_is_no_practice(tmp_path: Path) -> None:
    text = "who,shown,said,group,demographics\n1,felt,cork,training,x\n2,cork,cork,control,\n"
    assert _read(tmp_path, text).doubts == ()


def test_a_column_that_leaves_rows_out_may_be_in_some_files_alone(tmp_path: Path) -> None:
    texts = "who,shown,said,phase\n1,felt,cork,practice\n1,cork,cork,main\n", "who,shown,said\n2,felt,felt\n"
    for rule in (("phase", "practice"), ("phase", "")):
        made = _made(tmp_path, *texts, layout=replace(PLAIN, leave_out=(rule,)), out="out" + rule[1])
        assert made.sentences[0].startswith("Participants: 2.")
    with pytest.raises(DatasetError) as refused:
        _made(tmp_path, *texts, layout=replace(PLAIN, leave_out=(("fase", "practice"),)), out="none")
    assert refused.value.finding.field == "column fase"


def test_one_participant_in_another_unit_is_a_caution(tmp_path: Path) -> None:
    rows = "".join(
        f"{who},{shown},cork,{time}\n"
        for who, time in (("a", 0.8), ("b", 0.7), ("c", 812), ("d", 0.9))
        for shown in ("felt", "cork")
    )
    text = f"who,shown,said,rt\n{rows}"
    (doubt,) = _read(tmp_path, text, replace(PLAIN, time_s="rt")).doubts
    assert (doubt.check, doubt.verdict, _added(doubt)) == ("response times", "warns", ("--leave-out", "who=c"))
    assert "'c' (812 s)" in doubt.what
    (doubt,) = _read(tmp_path, text, replace(PLAIN, time_s="rt", people={"c": "C"})).doubts
    assert _added(doubt) == ("--leave-out", "who=c", "--leave-out", "who=C")


@pytest.mark.parametrize(("column", "first", "second"), [("session", "2", "10"), ("date", "2024-05-01", "2024-05-02")])
def test_two_sessions_of_one_person_are_asked_about_and_follow_one_another(
    tmp_path: Path, column: str, first: str, second: str
) -> None:
    head = f"who,shown,said,trials.thisN,{column},key.started\n"
    texts = [
        head + "".join(f"1,{shown},{said},{n},{cell},{n}.{cell[-1]}\n" for n, shown in enumerate(("felt", "cork")))
        for said, cell in (("felt", first), ("cork", second))
    ]
    layout = replace(PLAIN, trial="trials.thisN")
    with pytest.raises(DatasetError) as refused:
        _made(tmp_path, *texts, layout=layout)
    assert _added(refused.value.finding) == ("--session", column)
    made = _made(tmp_path, *texts, layout=replace(layout, session=column))
    held = (made.root / "sourcedata" / "lab_trials.csv").read_text().splitlines()[1:]
    assert [row.split(",")[2:7] for row in held] == [
        ["0", "1", "2", "felt", "felt"],
        ["1", "1", "3", "cork", "felt"],
        ["0", "2", "2", "felt", "cork"],
        ["1", "2", "3", "cork", "cork"],
    ]
    assert not any("restarted" in sentence for sentence in made.sentences)


def test_the_rarer_spelling_of_a_material_is_mapped_and_others_stand_for_themselves(tmp_path: Path) -> None:
    text = "who,shown,said\n1,CORK,CORK\n1,cork,cork\n1,cork,felt\n1,felt,1\n"
    with pytest.raises(DatasetError) as refused:
        _read(tmp_path, text, replace(PLAIN, answers={"1": "felt"}))
    added = _added(refused.value.finding)
    assert added == ("--map-presented", "CORK=cork", "--map", "CORK=cork")
    layout = replace(PLAIN, materials={"CORK": "cork"}, answers={"1": "felt", "CORK": "cork"})
    assert _read(tmp_path, text, layout).materials == ("cork", "felt")


def test_one_map_of_a_code_forbids_no_material_that_was_answered(tmp_path: Path) -> None:
    layout = replace(PLAIN, materials={"f.wav": "felt"})
    text = "who,shown,said\n1,f.wav,felt\n1,cork,cork\n"
    assert _read(tmp_path, text, layout).materials == ("cork", "felt")
    with pytest.raises(DatasetError) as refused:
        _read(tmp_path, "who,shown,said\n1,1,1\n1,2,2\n1,3,3\n", replace(PLAIN, materials={"1": "felt", "2": "cork"}))
    assert {one.field for one in refused.value.findings[:-1]} == {"column shown", "column said"}
    added = _added(refused.value.findings[-1])
    assert added[:2] == ("--map-presented", "3=MATERIAL")
    assert set(added[3::2]) == {"1=MATERIAL", "2=MATERIAL", "3=MATERIAL"}


def test_other_spellings_of_answers_are_mapped_with_one_command(tmp_path: Path) -> None:
    rows = "".join(f"1,{one},{one.capitalize()}\n1,{one},{one}\n" for one in ("foil", "felt", "cork", "sand"))
    with pytest.raises(DatasetError) as refused:
        _read(tmp_path, f"who,shown,said\n1,FOIL,foil\n{rows}")
    assert _added(refused.value.findings[-1])[1::2].count("Foil=foil") == 1
    with pytest.raises(DatasetError) as refused:
        _read(tmp_path, f"who,shown,said\n{rows}")
    maps = pairs("--map", _added(refused.value.findings[-1])[1::2])
    assert maps == {"Foil": "foil", "Felt": "felt", "Cork": "cork", "Sand": "sand"}
    assert len(_read(tmp_path, f"who,shown,said\n{rows}", replace(PLAIN, answers=maps)).rows) == 8


def test_json_has_elements_and_no_lines(tmp_path: Path) -> None:
    trials = [{"who": 1, "shown": shown, "said": "cork", "rt": rt} for shown, rt in (("cork", 0.5), ("felt", -1))]
    path = _file(tmp_path, json.dumps(trials), "js.json")
    with pytest.raises(DatasetError) as refused:
        read_trials([path], replace(PLAIN, time_s="rt"))
    assert (refused.value.finding.part, refused.value.finding.line) == ("element", 2)
    assert "element 2" in str(refused.value)


def test_who_stands_in_several_files_is_shown_and_not_in_the_dataset(tmp_path: Path) -> None:
    head = "who,shown,said\n"
    made = _made(tmp_path, _people("Ann", "Bob"), f"{head}Bob,felt,felt\n")
    assert "02 ('Bob')" in made.sentences[-1]
    assert not any("Bob" in path.read_text() for path in made.root.rglob("*") if path.is_file())


@pytest.mark.parametrize("name", ["Total", "grand_total", "MEAN", "Summe:", "Mittelwert"])
def test_a_row_that_sums_up_the_others_is_reported_and_its_remedy_leaves_it_out(tmp_path: Path, name: str) -> None:
    text = _people("a", "b") + f"{name},felt,cork\n"
    (doubt,) = _read(tmp_path, text).doubts
    assert (doubt.check, doubt.verdict, _added(doubt)) == ("summary", "warns", ("--leave-out", f"who={name}"))
    again = _read(tmp_path, text, replace(PLAIN, leave_out=cells(_added(doubt)[1::2])))
    assert ({row.participant for row in again.rows}, again.doubts) == ({"a", "b"}, ())


def test_a_participant_is_called_as_others_are(tmp_path: Path) -> None:
    assert _read(tmp_path, _people("meanwell", "allison", "sumi")).doubts == ()
    assert _read(tmp_path, _people("all")).doubts == ()
