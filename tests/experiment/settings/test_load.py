"""Every error of a file at once, at its place, in words for whoever writes the file."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from palpate.experiment import storage
from palpate.experiment.errors import ProtocolError
from palpate.experiment.findings import Finding
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.settings import load
from tests.approved import Refuses
from tests.experiment.protocol.small import SMALL, changed, document, leaves, places, protocol, without

JARGON = re.compile(r"pydantic|validat|input|instance|tuple|dict|NoneType|literal|regex|pattern|str\b|int\b", re.I)
OPTIONAL = {
    ("exclusion",),
    ("duration",),
    ("ethics", "approved_on"),
    ("ethics", "expires_on"),
    ("analysis", 1, "alpha"),
}


def refused(tmp_path: Path, text: str | bytes) -> tuple[Finding, ...]:
    file = tmp_path / "study.toml"
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(ProtocolError) as caught:
        files.load(file)
    assert str(caught.value).startswith(f"{file}: ")
    return caught.value.findings


def line_of(text: str, marker: str) -> int:
    (line,) = (i for i, line in enumerate(text.split("\n"), start=1) if marker in line)
    return line


def test_small_protocol_loads(tmp_path: Path) -> None:
    file = tmp_path / "study.toml"
    file.write_text(SMALL, encoding="utf-8")
    loaded = files.load(file)
    assert loaded == protocol()
    assert loaded.materials[1].description.startswith("[[materials]]")


@pytest.mark.parametrize("encode", [lambda t: t.replace("\n", "\r\n").encode(), lambda t: b"\xef\xbb\xbf" + t.encode()])
def test_files_of_windows_editors_load_alike(tmp_path: Path, encode: object) -> None:
    file = tmp_path / "study.toml"
    file.write_bytes(encode(SMALL))  # type: ignore[operator]
    assert files.load(file) == protocol()


# Old text, new text (`MARK` stands in the line where the problem is), path, got, part of what is allowed.
MISTAKES = [
    (
        'kind = "max-run"',
        'kind = "maxrun"',
        "tasks[0].order.kind",
        "'maxrun'",
        "one of: full-random, blocked-random, max",
    ),
    (
        "participants = 6 }",
        "participants = 0 }",
        "study.participants",
        "0",
        "a whole number at least 1 and at most 10000",
    ),
    ("samples = 1000", "samples = 2.0", "footstep.synthesis.samples", "2.0", "a whole number"),
    ("gate_top_mm = 18", "gate_top_mm = nan", "footstep.step.gate_top_mm", "nan", "a number greater than 0"),
    ("    110,", "    '110',", "footstep.synthesis.speeds_mm_s[1]", "'110'", "a number at least 10 and at most 10000"),
    ("    110,", "    1e300,", "footstep.synthesis.speeds_mm_s[1]", "1e+300", "a number at least 10 and at most 10000"),
    ('key = "k"', f"key = {[*range(40)]}", "materials[1].key", "an array of 40", "one ASCII character"),
    ('key = "k"', "key = [[1], [2]]", "materials[1].key", "an array of 2", "one ASCII character"),
    ('key = "k"', 'key = ["k", 2]', "materials[1].key", "['k', 2]", "one ASCII character"),
    ("    110,", "    40,", "footstep.synthesis.speeds_mm_s[1]", "40", "greater than the previous one (60)"),
    ("contact_mm = 0.5", "contact_mm = 9", "footstep.step.contact_mm", "9", "less than gate_bottom_mm (9)"),
    ("gate_bottom_mm = 9", "gate_bottom_mm = 19", "footstep.step.gate_bottom_mm", "19", "less than gate_top_mm (18)"),
    (
        "approved_on = 2020-02-01",
        'approved_on = "2020-02-01"',
        "ethics.approved_on",
        "'2020-02-01'",
        "a date without quotes",
    ),
    (
        "expires_on = 2021-02-01",
        "expires_on = 2020-02-01",
        "ethics.expires_on",
        "2020-02-01",
        "a date after approved_on",
    ),
    ("required = true", 'required = "yes"', "consent.required", "'yes'", "true or false"),
    (
        'noise = "pink"',
        'nois = "pink"',
        "masker.nois",
        "'pink'",
        "no such key; did you mean 'noise'? allowed keys: cri",
    ),
    ('key = "k"', 'key = "K"', "materials[1].key", "'K'", "one ASCII character, but no capital letter or space"),
    ('key = "k"', 'key = "0"', "answers.no_answer_key", "'0'", "a unique key: materials[1].key already has this value"),
    ('id = "cork"', 'id = "Felt"', "materials[1].id", "'Felt'", "a unique name: materials[0].id already has this"),
    ('id = "cork"', 'id = "n/a"', "materials[1].id", "'n/a'", "any name except"),
    ('spoken = ["cork"]', 'spoken = ["Cloth"]', "materials[1].spoken[0]", "'Cloth'", "a unique phrase"),
    (
        'spoken = ["cork"]',
        "spoken = []",
        "materials[1].spoken",
        "an array of 0",
        "an array of at least 1, each a single line",
    ),
    ('id = "two"', 'id = "Two"', "tasks[1].id", "'Two'", "lowercase letters and digits"),
    ("participants = 4", "participants = 7", "tasks[1].participants", "7", "at most study.participants (6)"),
    (", max_run = 2 }", " }", "tasks[0].order.max_run", "nothing", "kind 'max-run' needs it"),
    (
        'order.kind = "blocked-random"',
        "order = 3",
        "tasks[1].order",
        "3",
        "a table with the keys: kind, max_run (optional)",
    ),
    (
        "familiarisation.max_s = 66",
        "familiarisation.max_s = 5",
        "tasks[1].familiarisation.max_s",
        "5",
        "at least min_s (6)",
    ),
    ("max_s = 55", "max_s = 1980", "tasks[0].familiarisation.max_s", "1980", "less than the longest session"),
    ("repetitions = 3", "repetitions = 201", "tasks[0].repetitions", "201", "at most 200 with the order 'max-run'"),
    ("longest_min = 35", "longest_min = 19", "duration.longest_min", "19", "at least shortest_min (20)"),
    ("limit = 13", "limit = -1", "exclusion[0].limit", "-1", "a number at least 0"),
    ('action = "exclude-participant"', 'action = "exclude-trial"', "exclusion[1].action", "'exclude-trial'", "about a"),
    ('id = "gone"', 'id = "gaps"', "exclusion[1].id", "'gaps'", "a unique name"),
    ("chance = 0.5", "chance = 1", "analysis[0].chance", "1", "a number greater than 0 and less than 1"),
    ('form = "ICC(2,1)"', "chance = 0.5", "analysis[1].chance", "0.5", "'sign flips against chance' have this key"),
    (
        'tasks = ["one"]',
        'tasks = ["tow"]',
        "analysis[1].tasks[0]",
        "'tow'",
        "a task in this protocol, one of: one, two",
    ),
    ('tasks = ["one"]', 'tasks = ["one", "one"]', "analysis[1].tasks[1]", "'one'", "each task once"),
    ('test = "ICC"', 'test = "two-way ANOVA"', "analysis[1].tasks", "['one']", "at least 2 tasks"),
    ("masker_level_db_a = 71", "masker_level_db_a = 86", "exposure.masker_level_db_a", "86", "at most 85"),
    ("vibration_peak_m_s2 = 12.5", "vibration_peak_m_s2 = 101", "exposure.vibration_peak_m_s2", "101", "at most 100"),
    ('title = "The first"', 'title = " "', "tasks[0].title", "' '", "text, not blank"),
]

TEXTS = [
    ('title = "The first"', r'title = "The\tfirst"', "tasks[0].title", "'The first' with U+0009", "without control"),
    (
        'title = "The first"',
        r'title = "The \u202efirst"',
        "tasks[0].title",
        "The <U+202E>first' with U+202E",
        "without",
    ),
    ('id = "felt"', 'id = "(none)"', "materials[0].id", "'(none)'", "starts with a letter or digit"),
    ('id = "felt"', 'id = "=felt"', "materials[0].id", "'=felt'", "starts with a letter or digit"),
    ('id = "felt"', r'id = "fe\u200dlt"', "materials[0].id", "'fe<U+200D>lt' with U+200D", "invisible"),
    ('id = "felt"', r'id = "f\u0435lt"', "materials[0].id", "'f<U+0435>lt' with U+0435 (CYRILLIC SMALL", "look-alike"),
    ('"Grey felt."', r'"Grey f\uff45lt."', "materials[0].description", "with U+FF45 (FULLWIDTH LATIN", "look-alike"),
    ('title = "The first"', r'title = "\u0338 it"', "tasks[0].title", "U+0338 (COMBINING LONG SOLIDUS", "stray marks"),
    ('id = "gone"', r'id = "\u05d0\u05d1"', "exclusion[1].id", "with U+05D0 (HEBREW", "right-to-left letters"),
    ('id = "gone"', r'id = "go\nne"', "exclusion[1].id", "'go ne' with U+000A", "one line"),
]

# The problem stands in the line of this text, not in that of the change.
ELSEWHERE = {"answers.no_answer_key": 'no_answer_key = "0"', "analysis[1].tasks": 'tasks = ["one"]'}


@pytest.mark.parametrize(("old", "new", "path", "got", "allowed"), [*MISTAKES, *TEXTS])
def test_one_mistake(tmp_path: Path, old: str, new: str, path: str, got: str, allowed: str) -> None:
    assert SMALL.count(old) == 1
    text = SMALL.replace(old, new)
    found = {problem.field: problem for problem in refused(tmp_path, text)}
    problem = found[path]
    assert problem.line == line_of(SMALL, ELSEWHERE.get(path, old))
    assert got in problem.got
    assert allowed in problem.allowed


def test_every_mistake_at_once_in_the_order_of_lines(tmp_path: Path) -> None:
    # Each of these hides another's cause: with it, that other rule has nothing to compare.
    hiding = {
        "footstep.step.gate_top_mm",
        "footstep.step.gate_bottom_mm",
        "ethics.approved_on",
        "tasks[0].order.kind",
        "study.participants",
        "tasks[1].id",
    }
    text, expected = SMALL, set()
    for old, new, path, _, _ in MISTAKES:
        if old in text and path not in hiding:
            text = text.replace(old, new)
            expected.add(path)
    assert len(expected) > 20
    found = refused(tmp_path, text)
    # The key that `nois` should have been is missing too.
    assert {problem.field for problem in found} == expected | {"masker.noise"}
    lines = [problem.line for problem in found if problem.line is not None]
    assert lines == sorted(lines)
    assert len({problem.field for problem in found}) == len(found)


def test_a_rule_is_checked_though_a_type_is_wrong_elsewhere(tmp_path: Path) -> None:
    text = SMALL.replace("gate_top_mm = 18", "gate_top_mm = '18'").replace("contact_mm = 0.5", "contact_mm = 10")
    found = [problem.field for problem in refused(tmp_path, text)]
    assert found == ["footstep.step.gate_top_mm", "footstep.step.contact_mm"]


REQUIRED = [path for path, _ in places(document()) if isinstance(path[-1], str) and path != ("answers", "mode")]


@pytest.mark.parametrize("path", REQUIRED, ids=str)
def test_a_missing_key_is_named_at_its_table(path: tuple[str | int, ...]) -> None:
    broken = without(document(), path)
    lines = {path[:-1]: 17} if path[:-1] else {}
    found = {problem.field: problem for problem in load.find(ProtocolFile, broken, lines)}
    if path in OPTIONAL:
        assert not found
        return
    problem = found[load.written(path)]
    assert problem.got == "nothing"
    assert problem.line == (17 if path[:-1] else None)
    assert not JARGON.search(problem.allowed)


@pytest.mark.parametrize(("path", "value"), list(places(document())), ids=str)
def test_a_wrong_type_is_named_in_plain_words(path: tuple[str | int, ...], value: object) -> None:
    wrong = 7.5 if isinstance(value, str | dict | tuple | bool) else {"a": 1}
    found = {problem.field: problem for problem in load.find(ProtocolFile, changed(document(), path, wrong), {path: 3})}
    problem = found[load.written(path)]
    assert problem.line == 3
    assert problem.got in ("7.5", "a table")
    assert not JARGON.search(problem.allowed)


@pytest.mark.parametrize("path", [path for path, _ in leaves(document()) if len(str(path[-1])) > 4], ids=str)
def test_a_typing_error_in_a_key_is_recognised(path: tuple[str | int, ...]) -> None:
    *parents, key = path
    misspelt = (*parents, str(key)[:2] + "q" + str(key)[2:])
    broken = changed(without(document(), path), misspelt, "x")
    found = {problem.field: problem for problem in load.find(ProtocolFile, broken, {})}
    assert f"did you mean '{key}'?" in found[load.written(misspelt)].allowed


def test_an_unknown_key_is_quoted_where_it_needs_quotes(tmp_path: Path) -> None:
    (problem,) = refused(tmp_path, SMALL.replace("[masker]", '[masker]\n"a key" = 1'))
    assert problem.field == 'masker."a key"'


@pytest.mark.parametrize(
    ("old", "new", "line", "column", "allowed"),
    [
        ('noise = "pink"', 'noise "pink"', line_of(SMALL, 'noise = "pink"'), 7, "Expected '=' after a key"),
        ("[masker]", "[masker]\n[masker]", line_of(SMALL, "[masker]") + 1, 8, "Cannot declare"),
        ('noise = "pink"', 'noise = "pink', line_of(SMALL, 'noise = "pink"'), 14, "Illegal character"),
        ("alpha = 0.01\n", "alpha = '''", SMALL.count("\n"), 12, "TOML"),
    ],
)
def test_broken_syntax(tmp_path: Path, old: str, new: str, line: int, column: int, allowed: str) -> None:
    (problem,) = refused(tmp_path, SMALL.replace(old, new))
    assert problem.line == line
    assert problem.field == f"column {column}"
    assert allowed in problem.allowed
    assert problem.allowed.endswith("fix this first")


@pytest.mark.parametrize(
    "text", ["a." * 5000 + "a = 1", f"a = {'[' * 40}{']' * 40}", f"a = 0x{'f' * 6000}", f"format = {2**63}"]
)
def test_what_no_file_needs_is_refused(tmp_path: Path, text: str) -> None:
    (problem,) = refused(tmp_path, text)
    assert problem.allowed.startswith("at most 32 levels")


@pytest.mark.parametrize("day", ["2020-02-01T07:32:00", "2020-02-01T07:32:00Z", "07:32:00"])
def test_a_date_with_a_time_is_no_date(tmp_path: Path, day: str) -> None:
    (problem,) = refused(tmp_path, SMALL.replace("approved_on = 2020-02-01", f"approved_on = {day}"))
    assert (problem.field, problem.allowed[-10:]) == ("ethics.approved_on", "2012-04-01")


@pytest.mark.parametrize("text", [f"a = {'[' * 5000}", f"a = {'9' * 5000}"])
def test_absurd_text_is_refused(tmp_path: Path, text: str) -> None:
    (problem,) = refused(tmp_path, text)
    assert problem.allowed.startswith("TOML; ")
    assert "sys." not in problem.allowed


def test_an_empty_file_misses_every_required_table(tmp_path: Path) -> None:
    missing = {problem.field for problem in refused(tmp_path, "")}
    assert missing == {name for name, field in ProtocolFile.model_fields.items() if field.is_required()}


def test_what_is_not_utf8_is_named_by_line_and_byte(tmp_path: Path) -> None:
    (problem,) = refused(tmp_path, SMALL.replace("Grey felt", "Gr\u00e4y felt").encode("latin-1"))
    assert problem.line == line_of(SMALL, "Grey felt")
    assert problem.field.startswith("byte 18 ")
    assert "0xe4" in problem.got
    assert "UTF-8" in problem.allowed


def test_a_missing_file_suggests_one_with_a_near_name(tmp_path: Path, refuses: Refuses) -> None:
    (tmp_path / "okamoto2012.toml").write_text("", encoding="utf-8")
    with refuses(ProtocolError):
        files.load(tmp_path / "okamoto.toml")


def test_a_missing_file_in_a_missing_folder(tmp_path: Path, refuses: Refuses) -> None:
    with refuses(ProtocolError):
        files.load(tmp_path / "nowhere" / "study.toml")


def test_a_folder_is_no_file(tmp_path: Path, refuses: Refuses) -> None:
    with refuses(ProtocolError):
        files.load(tmp_path)


def test_a_file_of_nothing_but_unknown_keys_is_told_in_part(tmp_path: Path) -> None:
    """Words for each of the 90,000 that a file can hold took minutes."""
    path = tmp_path / "many.toml"
    path.write_text("".join(f"k{n} = 1\n" for n in range(load.MOST_TOLD + 9)), "utf-8")
    with pytest.raises(ProtocolError) as refused:
        load.read(path, load.Confined)
    assert len(refused.value.findings) == load.MOST_TOLD


def test_a_key_of_very_many_parts_is_refused_before_it_is_parsed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tomllib takes time by the square of their number: 25 s for 20,000."""
    monkeypatch.setattr("tomllib.loads", None)
    (problem,) = refused(tmp_path, "# A comment\nx" + ".a" * 20_000 + " = 1\n")
    assert (problem.line, problem.got) == (2, storage.TOO_DEEP)
