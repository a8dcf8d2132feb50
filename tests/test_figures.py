"""What the figures of the house count: each fault is planted in a few lines, and is seen there and nowhere else."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from textwrap import dedent

import pytest

from tests.figures import TRUNKS, Figure
from tests.measures import imports, kinds
from tests.measures.parameters import unvaried_parameters
from tests.measures.patterns import complex_functions, multiplied_texts, sentence_assertions, sentence_matches
from tests.measures.source import Source, entries, is_inside, module_of, tracked_files

Count = Callable[[Source], Iterator[str]]

ROOM = "experiment/desk"
ONE = f"{ROOM}/one.py"
TEXT = "def text(section, width=80): ...\ntext(one)\n"


def source(text: str, path: str = ONE) -> Source:
    return Source(path, dedent(text))


def lines(count: Count, text: str) -> list[int]:
    """The lines of a text that a count names."""
    return sorted(int(place.split(" ")[0].rpartition(":")[2]) for place in count(source(text)))


def never_varied(text: str, path: str = ONE, **others: str) -> set[str]:
    """The parameters that nothing varies in a module, and in others of its room."""
    files = [source(text, path), *(source(other, f"{ROOM}/{name}.py") for name, other in others.items())]
    return {f"{each.function.name}.{each.parameter}={each.value}" for each in unvaried_parameters(files)}


def test_a_module_is_named_by_its_path() -> None:
    room = "palpate.experiment.desk"
    assert module_of(ONE) == f"{room}.one"
    assert module_of(ROOM) == module_of(f"{ROOM}/__init__.py") == room
    assert is_inside(ONE, [ROOM])
    assert not is_inside("experiment/desktop.py", ["experiment/desk"])


def test_a_figure_above_its_limit_says_where() -> None:
    many = tuple(f"one.py:{number}" for number in range(1, 12))
    assert Figure("things", 11, 11, many).line.endswith(" 11 of at most 11")
    assert Figure("things", 11, 10, many).line.endswith(": " + "; ".join((*many[:8], "...")))
    assert Figure("things", 2, 1, many[:2]).line.endswith(": " + "; ".join(many[:2]))


def test_entries_are_modules_files_and_rooms() -> None:
    paths = ["a/__init__.py", "a/README.md", "a/one.py", "a/data.json", "a/room/__init__.py", "a/room/two.py"]
    assert entries(map(Path, paths)) == {"a": 3, "a/room": 1}


@pytest.mark.parametrize("branches", [19, 20])
def test_a_function_of_grade_d(branches: int) -> None:
    """Complexity is one more than the branches, and 21 is D."""
    decides = "".join(f"    if n == {number}:\n        n = 0\n" for number in range(branches))
    text = f"def long(n):\n{decides}class One:\n  def long(self, n):\n" + decides.replace("    ", "      ")
    expected = [] if branches < 20 else [1, 3 + 2 * branches]
    assert lines(complex_functions, text) == expected


def test_a_function_inside_of_another_counts_alone() -> None:
    decides = "".join(f"        if n == {number}:\n            n = 0\n" for number in range(20))
    text = f"def outer(n):\n    def inner():\n        n = 1\n{decides}    if n:\n        return inner()\n"
    assert lines(complex_functions, text) == [2]


def test_assertions_that_hold_part_of_a_sentence() -> None:
    text = """\
    assert found == "nobody has been enrolled yet"
    assert found == "nobody was enrolled"
    assert f"of {count} people who agreed to it" in found
    assert found == ("two words", "three other words")
    assert found.counts == {"a_key_of_json": 1, "b, c, d, e": 2}
    assert found, "the words of a message count too"
    said = "what is not asserted does not count"
    """
    assert lines(sentence_assertions, text) == [1, 3, 6]


def test_matches_that_hold_part_of_a_sentence() -> None:
    text = """\
    with pytest.raises(ValueError, match=r"the file .* is not there"): ...
    with pytest.raises(ValueError, match="^three plain words$"): ...
    with pytest.raises(
        ValueError,
        match=f"got {count}; allowed: at most so many",
    ): ...
    found = re.search("a pattern that is no match of a call", text)
    """
    assert lines(sentence_matches, text) == [1, 5]


def test_texts_that_are_multiplied_by_a_condition() -> None:
    text = """\
    shown = f"{n} trial{'s' * (n != 1)}"
    shown = bool(why) * f" ({why})"
    shown = " of those asked" * several
    shown = ", erased" * self.is_erased
    shown = "x" * (not one) + "y" * (one and two)
    rule = "-" * width + "=" * len(title) + " " * 4
    power = 2 * (n > 1)
    parts = ["left"] * (n > 1)
    """
    assert lines(multiplied_texts, text) == [1, 2, 3, 4, 5, 5]


EVERY_KIND = "OPENS = {" + ",\n".join(f'"{name}": one' for name in sorted(kinds.NAMES)) + "}"


@pytest.mark.parametrize(
    "decision",
    [
        "if protocol.footstep is None: ...",
        "shown = 1 if self.comparison is not None else 2",
        "if study.answers is not None: ...",
        "if self._view.pairs: ...",
        'if task.kind == "footstep": ...',
        'if _kind(task) != "tapping": ...',
        "if isinstance(entry, FootStep | Note): ...",
        "if isinstance(entry, tapping.Tapped): ...",
        "match entry:\n    case FootStep(): ...",
        'if task.design == "comparison": ...',
        EVERY_KIND,
    ],
)
def test_a_decision_by_kind_counts_outside_of_the_kinds_rooms(decision: str) -> None:
    text = (
        "from palpate.experiment.records.kinds import tapping\n"
        "from palpate.experiment.records.entries import Note\n"
        "from palpate.experiment.records.kinds.footstep import FootStep\n"
    )
    found = list(kinds.decisions(source(text + decision)))
    last = 4 + decision.count("\n")
    assert found == [f"{ONE}:{line}" for line in (range(4, last + 1) if decision == EVERY_KIND else [last])]
    at_home = source(text + decision, f"{kinds.ROOMS[-1]}/trials.py")
    assert list(kinds.decisions(at_home)) == []


def test_what_is_no_decision_by_kind() -> None:
    text = """\
    from palpate.experiment.records.entries import Note
    if isinstance(entry, Note): ...
    if task.order.kind == "fixed" or section.slug == "comparison": ...
    if results.pairs or found.footstep == 2 or protocol.title is None: ...
    paths = {"comparison": one, "other": two}
    """
    assert list(kinds.decisions(source(text))) == []


def test_a_parameter_that_every_caller_leaves_or_gives_alike() -> None:
    text = """\
    WIDTH = 80
    def text(section, width=WIDTH, *, full=False, indent): ...
    text(one, indent=2)
    text(two, indent=2, full=False)
    """
    assert never_varied(text) == {"text.width=WIDTH", "text.full=False", "text.indent=2"}


@pytest.mark.parametrize(
    "caller",
    [
        "text(three, 100)",
        "text(three, width=wanted)",
        "text(*parts)",
        "text(three, **given)",
        "shown = map(text, sections)",
        "start(target=text)",
        "class One:\n  def show(self):\n    return [text(each, width) for each in self.every]",
    ],
)
def test_a_parameter_that_one_caller_may_vary(caller: str) -> None:
    assert never_varied(TEXT) == {"text.width=80"}
    assert never_varied(f"{TEXT}{caller}\n") == set()


@pytest.mark.parametrize(
    "caller",
    [
        "from palpate.experiment.desk.one import text\ntext(two, 100)",
        "from palpate.experiment.desk.one import text as shown\nshown(two, 100)",
        "from palpate.experiment.desk import one\ndef show():\n    return one.text(two, 100)",
        "import palpate.experiment.desk.one\npalpate.experiment.desk.one.text(two, 100)",
        "from palpate.experiment.desk.handed import text\ntext(two, 100)",
    ],
)
def test_callers_are_followed_along_imports(caller: str) -> None:
    """The last one imports the function from a module that only hands it on."""
    handed = "from palpate.experiment.desk.one import text\n"
    assert never_varied(TEXT, handed=handed) == {"text.width=80"}
    assert never_varied(TEXT, handed=handed, other=caller) == set()


def test_a_variable_is_not_the_function_of_its_name() -> None:
    text = """\
    def text(section, width=80): ...
    text(one)
    def show(text, parts):
        return text, [text for text in parts], sorted(parts, key=lambda text: text.lower())
    def other():
        text = 1
        return text
    """
    assert never_varied(text) == {"text.width=80"}


def test_parameters_of_methods() -> None:
    text = """\
    class Sheet:
        def __init__(self, size, margin=2): ...
        def show(self, width=80): ...
        @classmethod
        def blank(cls, size=4): return cls(size)
        @staticmethod
        def rule(width): ...
        def both(self):
            self.show()
            Sheet.rule(3)
    Sheet(1).show()
    Sheet(2).show(80)
    Sheet.blank()
    """
    assert never_varied(text) == {
        "Sheet.__init__.margin=2",
        "Sheet.show.width=80",
        "Sheet.blank.size=4",
        "Sheet.rule.width=3",
    }
    varied = text + "unknown.show(90)\n    Sheet(3, margin)\n"
    assert never_varied(varied) == {"Sheet.blank.size=4", "Sheet.rule.width=3"}


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("a port", "class Port(Protocol):\n  def read(self, wait=1): ...\none.read()"),
        (
            "what fits a port",
            "class Port(Protocol):\n  def read(self): ...\nclass Line:\n  def read(self, wait=1): ...\none.read()",
        ),
        (
            "an override",
            "class Base:\n  def read(self): ...\nclass Line(Base):\n  def read(self, wait=1): ...\nLine().read()",
        ),
        (
            "what is overridden",
            "class Base:\n  def read(self, wait=1): ...\nclass Line(Base):\n  def read(self, wait): ...\nBase().read()",
        ),
        (
            "of a foreign class",
            "from foreign import Widget\nclass Pane(Widget):\n  def show(self, wait=1): ...\none.show()",
        ),
        ("a command", "@commands.command()\ndef run(lines=False): ...\nrun()"),
        ("a field", "@dataclass\nclass Sheet:\n  size: int = 2\nSheet()"),
        ("what nobody calls", "def text(width=80): ..."),
        ("what a closure keeps", "def show(sizes):\n  def one(size=size): ...\n  return one()"),
    ],
)
def test_parameters_that_others_decide(kind: str, text: str) -> None:
    head = "from typing import Protocol\nfrom dataclasses import dataclass\n"
    assert never_varied(head + text) == set(), kind


def test_what_a_foreign_class_is_given_is_no_call_of_ours() -> None:
    text = "class Sheet:\n  def __init__(self, size=4): ...\nSheet()\n"
    other = "class Pane(Widget):\n  def __init__(self, size):\n    super().__init__(size)\n"
    assert never_varied(text + other) == {"Sheet.__init__.size=4"}


def test_a_field_is_not_a_method_that_is_passed_on() -> None:
    text = """\
    class Sheet:
        def text(self, width=80): ...
    class Note:
        text: str
    Sheet().text()
    """
    assert never_varied(text + "shown = note.text\n") == {"Sheet.text.width=80"}
    assert never_varied(text.replace("text: str", "pass") + "shown = note.text\n") == set()
    started = "class Page(Sheet):\n        def start(self):\n            return self.text\n"
    assert never_varied(text + started) == set()


def test_a_trunk_is_what_one_module_imports() -> None:
    def named(*names: str) -> set[str]:
        return {f"palpate.experiment{name and '.'}{name}" for name in names}

    pairs = [
        ("session.run", "session.kind"),
        ("session.kind", "records.entries"),
        ("session.run", "desk.voice.ear"),
        ("desk.voice.ear", "desk.link"),
        ("desk.link", "records.footstep"),
        ("cli.session", "session.run"),
    ]
    graph = {(f"palpate.experiment.{one}", f"palpate.experiment.{other}") for one, other in pairs}
    trunk = imports.trunk_modules(imports.Trunk("experiment/session/run.py"), graph)
    inner = named("", "session", "session.run", "session.kind", "records", "records.entries")
    voice = named("desk", "desk.voice", "desk.voice.ear", "desk.link", "records.footstep")
    assert trunk == {"palpate", *inner, *voice}
    mute = imports.Trunk("experiment/session/run.py", without=("experiment/desk/voice",))
    assert imports.trunk_modules(mute, graph) == {"palpate", *inner}


def test_a_wing_is_its_rooms_and_modules() -> None:
    paths = ["analysis/power/report.py", "analysis/power/__init__.py", "analysis/powerful.py", "analysis/export.py"]
    sources = [source("one\n" * (number + 1), path) for number, path in enumerate(paths)]
    assert imports.wing_lines(["analysis/power", "analysis/export.py"], sources) == 1 + 2 + 4


def test_every_room_that_a_figure_names_is_there_and_in_one_wing() -> None:
    paths = [file.as_posix() for file in tracked_files("experiment", "analysis")]
    named = [room for rooms in imports.WINGS.values() for room in rooms]
    trunks = [room for trunk in imports.TRUNKS.values() for room in (trunk.root, *trunk.without)]
    assert [
        room for room in (*named, *trunks, *kinds.ROOMS) if not any(is_inside(path, [room]) for path in paths)
    ] == []
    assert [path for path in paths if sum(is_inside(path, [room]) for room in named) > 1] == []
    assert set(TRUNKS) == set(imports.TRUNKS)


def test_circles_and_arrows_upward() -> None:
    graph = {("a", "b"), ("b", "c"), ("c", "a"), ("c", "d")}
    assert imports.circles(graph) == {"a, b, c"}
    assert imports.circles(graph - {("c", "a")}) == set()
    layers = [
        {"type": "layers", "containers": ["palpate.experiment"], "layers": ["cli", "dataset | recordings", "clock"]}
    ]
    down, up, beside = ("cli.app", "clock"), ("clock", "cli.app"), ("dataset.build", "recordings.store")
    for (one, other), is_refused in ((down, False), (up, True), (beside, True)):
        arrow = f"palpate.experiment.{one}", f"palpate.experiment.{other}"
        assert bool(imports.upward_imports({arrow}, layers)) is is_refused, arrow
