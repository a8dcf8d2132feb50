"""The house itself: layers, light start, size and style."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from palpate.analysis import export
from palpate.analysis.designs import named
from palpate.experiment import errors
from palpate.experiment.dataset import build
from palpate.experiment.protocol import designs, kinds
from palpate.experiment.protocol.designs import design_of
from palpate.experiment.protocol.kinds import kind_of
from palpate.experiment.protocol.page.words import design_words, kind_words
from palpate.experiment.records import events
from palpate.experiment.records.kinds import entries_of
from palpate.experiment.rehearsal.designs import judge_of
from palpate.experiment.rehearsal.kind import rehearsal_kind
from palpate.experiment.session.kind import session_kind
from tests.__main__ import marked
from tests.conftest import LONGEST
from tests.figures import figures
from tests.measures.patterns import errors_in_text
from tests.measures.source import FOLDERS, Source, read_sources, tracked_files

HEAVY = ("numpy", "scipy", "pandas", "matplotlib", "statsmodels", "psychopy", "serial", "rich", "textual")

DOCUMENTS = (
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "analysis/README.md",
    "experiment/decisions.md",
    "experiment/README.md",
    "experiment/apparatus/README.md",
    "protocols/README.md",
    "tests/README.md",
)


ERRORS = {
    name for name, kind in vars(errors).items() if isinstance(kind, type) and issubclass(kind, errors.PalpateError)
}
"""Every class of our errors, by name."""

RENDERERS = ("experiment/errors.py", "experiment/cli/app.py")
"""Here the sentence of an error is made, and shown as the last of a command."""


NO_NAMES = {
    "asked",
    "believed",
    "beside",
    "between",
    "by",
    "found",
    "given",
    "held",
    "kept",
    "made",
    "near",
    "of",
    "over",
    "said",
    "settled",
    "stands",
    "told",
    "within",
    "without",
}
"""A function that is called so says neither what it gives nor what it does."""


def run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *arguments], cwd=cwd, capture_output=True, text=True, check=False)


def test_a_trial_flows_one_way(repository_root: Path) -> None:
    linter = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run([linter, "--no-cache"], cwd=repository_root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    "command",
    [
        ["--help"],
        ["--version"],
        ["rehearse", "--help"],
        ["analyse", "--help"],
        ["audit", "--help"],
        ["doctor", "--help"],
    ],
)
def test_help_imports_nothing_heavy(repository_root: Path, command: list[str]) -> None:
    code = f"""
import sys
from palpate.experiment.cli.app import app
try:
    app({command!r})
except SystemExit as end:
    assert not end.code, end.code
print(sorted(set({HEAVY!r}) & set(sys.modules)), file=sys.stderr)
"""
    done = run("-c", code, cwd=repository_root)
    assert (done.returncode, done.stderr.strip()) == (0, "[]"), done.stdout


def test_an_impact_without_a_plot_imports_nothing_that_draws(repository_root: Path) -> None:
    code = """
import sys
from palpate.experiment.cli.app import app
try:
    app("tap contact --stiffness 2500 --damping 10 --mass 0.1 --speed 0.2".split())
except SystemExit as end:
    assert not end.code, end.code
print(sorted({"matplotlib", "pandas", "scipy"} & set(sys.modules)), file=sys.stderr)
"""
    done = run("-c", code, cwd=repository_root)
    assert (done.returncode, done.stderr.strip()) == (0, "[]"), done.stdout


@pytest.fixture(scope="module")
def sources() -> tuple[Source, ...]:
    """Every Python file of the source, each parsed once."""
    return read_sources(tracked_files(*FOLDERS))


def test_the_house_is_no_larger_than_its_plan(sources: tuple[Source, ...]) -> None:
    above = [figure.line for figure in figures(sources) if figure.found > figure.most]
    assert not above, "\n".join(above)


def test_nothing_takes_an_error_of_ours_for_a_text(sources: tuple[Source, ...]) -> None:
    """Whoever needs a part of it has its finding; whoever says more of it carries the finding on."""
    places = [place for one in sources if one.path not in RENDERERS for place in errors_in_text(one, ERRORS)]
    assert places == []


def test_no_remedy_leaves_open_how(sources: tuple[Source, ...]) -> None:
    empty = re.compile(r'["; ]mend it"')
    assert [one.path for one in sources if empty.search(one.text)] == []


def test_a_function_has_a_name_that_says_what_it_gives_or_does(sources: tuple[Source, ...]) -> None:
    """A participle of what was told or held, or a preposition, says nothing where it is called."""
    named = [
        one.place(node)
        for one in sources
        for node in one.nodes
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.strip("_") in NO_NAMES
    ]
    assert named == []


def test_what_a_test_replaces_is_there(repository_root: Path) -> None:
    """`mock.patch.object` and `monkeypatch` refuse a name that is gone; assigned to, it would be replaced in vain."""
    assigned = re.compile(r'^\s*vars\(.*\)\["(?!__builtins__)\w+"\] = ', re.MULTILINE)
    tests = [path for path in tracked_files("tests") if path.suffix == ".py"]
    assert [path for path in tests if assigned.search((repository_root / path).read_text("utf-8"))] == []


def test_every_kind_of_trial_and_every_design_supplies_all_that_one_is_asked_for() -> None:
    """A new one is a name in a list, and modules of that name."""
    for task in (SimpleNamespace(kind=name) for name in kinds.NAMES):
        assert kind_of(task.kind).intervals
        assert set(events.columns_of(task.kind)) > {"trial", "answered"}
        for look_up in (kind_words, build.kind_of, session_kind, rehearsal_kind):
            assert look_up(cast("Any", task))
        assert entries_of(task.kind)
    for task in (SimpleNamespace(design=name) for name in designs.NAMES):
        assert design_of(task.design).intervals
        assert design_words(cast("Any", task))
        assert callable(judge_of(cast("Any", task)))
        assert set(export.columns_of(named(task.design).name)) > {"exclusions.csv"}


@pytest.mark.parametrize(
    ("line", "count"),
    [
        ("why = str(error)", 1),
        ('raise RigError(f"{error}; and more") from error', 1),
        ("what, *rest = error.args", 1),
        ("why = format(error)", 1),
        ("print(error, file=sys.stderr)", 1),
        ('why = "%s" % error', 1),
        ("why = error.__str__()", 1),
        ('what, _, remedy = error.sentence().partition(";")', 1),
        ('where = error.finding.what.split(":")', 1),
        ('where = path.name.split(":")', 0),
        ('raise RigError(path, f"{error!r}") from error', 1),
        ('raise RigError(path, f"{error.sentence()}; and more") from error', 1),
        ("raise RigError(cause(error)) from error", 1),
        ('tell(f"The session waits: {error.sentence()}")', 0),
        ("raise RigError.at(replace(error.finding, where=path)) from error", 0),
        ("why = str(path)", 0),
    ],
)
@pytest.mark.parametrize("kind", ["RosterError", "(ValueError, errors.RigError)", "ValueError"])
def test_an_error_that_is_taken_for_a_text_is_found(line: str, count: int, kind: str) -> None:
    caught = Source("module.py", f"try:\n    act()\nexcept {kind} as error:\n    {line}\n")
    assert len([*errors_in_text(caught, ERRORS)]) == (0 if kind == "ValueError" else count)
    given = Source("module.py", f'def tell(path: Path, error: "RigError | None") -> None:\n    {line}\n')
    assert len([*errors_in_text(given, ERRORS)]) == count


@pytest.fixture(scope="module")
def through_typer(repository_root: Path) -> str:
    """The overview as typer writes it."""
    done = run("-c", "from palpate.experiment.cli.app import app; app(['--help'])", cwd=repository_root)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("arguments", [[], ["-h"], ["--help"]])
def test_the_overview_is_there_at_once_and_the_same_through_typer(
    repository_root: Path, through_typer: str, arguments: list[str]
) -> None:
    """Without typer it takes less than twice as long as a bare interpreter, with it seven times as long."""
    asked = f"""
import sys
sys.argv[1:] = {arguments!r}
from palpate.experiment.__main__ import main
main()
print(sorted({{"typer", "pydantic", *{HEAVY!r}}} & set(sys.modules)), file=sys.stderr)
"""
    done = run("-c", asked, cwd=repository_root)
    assert (done.returncode, done.stderr.strip()) == (0, "[]")
    assert done.stdout == through_typer


@pytest.mark.parametrize(
    "package",
    [
        "palpate",
        "palpate.experiment",
        "palpate.analysis",
        "palpate.experiment.protocol",
        "palpate.experiment.rehearsal",
    ],
)
def test_packages_import_light(repository_root: Path, package: str) -> None:
    done = run("-c", f"import sys, {package}; print(sorted(set({HEAVY!r}) & set(sys.modules)))", cwd=repository_root)
    assert done.stdout.strip() == "[]", done.stderr


@pytest.mark.parametrize("tool", [["check"], ["format", "--check"]], ids=["ruff", "format"])
def test_style(repository_root: Path, tool: list[str]) -> None:
    done = run("-m", "ruff", *tool, ".", cwd=repository_root)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


def test_types(repository_root: Path) -> None:
    """mypy reports success on the modules that it finds, so it has to find all of them, and here."""
    done = run("-m", "mypy", "--verbose", cwd=repository_root)
    assert done.returncode == 0, done.stdout[-3000:] + re.sub(r"^LOG:.*\n", "", done.stderr, flags=re.MULTILINE)
    found = re.findall(r"^LOG: +Found source: .*path='(.+?)', module='(.+?)'", done.stderr, re.MULTILINE)
    assert {"palpate.experiment.__main__", "palpate.analysis.analyse"} <= {module for _, module in found}
    rooms = (repository_root / folder for folder in ("experiment", "analysis", "tests"))
    face = {repository_root / "palpate" / name for name in ("__init__.pyi", "library.py")}
    sources = face.union(path for room in rooms for path in room.rglob("*.py"))
    assert sources - {Path(path).resolve() for path, _ in found} == set()


def test_the_longest_modules_start_first(repository_root: Path, request: pytest.FixtureRequest) -> None:
    assert [module for module in LONGEST if not (repository_root / module).is_file()] == []
    collected = list(dict.fromkeys(item.path for item in request.session.items))
    listed = [repository_root / module for module in LONGEST if repository_root / module in collected]
    assert collected[: len(listed)] == listed


@pytest.mark.parametrize("mark", ["clocked", "alone"])
def test_a_marked_module_runs_in_its_part(request: pytest.FixtureRequest, mark: str) -> None:
    bearing = {str(item.path) for item in request.session.items if item.get_closest_marker(mark)}
    assert bearing <= set(marked(mark))


def test_the_readme_is_short(repository_root: Path) -> None:
    text = (repository_root / "README.md").read_text("utf-8")
    words = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE).split()
    assert len(words) <= 600


def changelog_faults(text: str) -> list[str]:
    """Return what keeps a user from reading the section on top: each name of a test, and more than 900 words."""
    top = re.split(r"^## .*$", text, flags=re.MULTILINE)[1]
    faults: list[str] = re.findall(r"\btest_\w*", top)
    if (words := len(top.split())) > 900:
        faults.append(f"{words} words")
    return faults


def test_the_changelog_is_readable(repository_root: Path) -> None:
    assert changelog_faults((repository_root / "CHANGELOG.md").read_text("utf-8")) == []


@pytest.mark.parametrize(
    ("top", "faults"),
    [
        ("word " * 900, []),
        ("word " * 901, ["901 words"]),
        ("### A heading\n\n- A page (`tests/rig/test_browser.py`).", ["test_browser"]),
    ],
    ids=["short", "long", "test"],
)
def test_a_changelog_that_is_not_readable_is_found(top: str, faults: list[str]) -> None:
    older = "word " * 901 + "test_browser"
    assert changelog_faults(f"# Changelog\n\n## Unreleased\n\n{top}\n\n## 0.1.0\n\n{older}\n") == faults


@pytest.mark.parametrize("document", DOCUMENTS, ids=str)
def test_what_a_document_names_is_there(repository_root: Path, document: str) -> None:
    text = (repository_root / document).read_text("utf-8")
    linked = [(repository_root / document).parent / link for link in re.findall(r"\]\(([^)#:]+)\)", text)]
    named = [repository_root / path for path in re.findall(r"`((?:experiment|analysis|tests|protocols)/[^` ]+)`", text)]
    assert linked + named
    assert [path for path in linked + named if not path.exists()] == []


def test_what_the_readme_of_the_experiment_names_is_there(repository_root: Path) -> None:
    room = repository_root / "experiment"
    named = set(re.findall(r"`([\w/]+\.py)`", (room / "README.md").read_text("utf-8")))
    assert named
    assert [name for name in named if not (room / name).is_file()] == []


def test_every_command_has_help_with_an_example() -> None:
    import typer

    from palpate.experiment.cli import COMMANDS
    from palpate.experiment.cli.app import app

    group = typer.main.get_command(app)
    assert isinstance(group, typer.core.TyperGroup)
    commands = dict(group.commands)
    told = {name: purpose for part in COMMANDS.values() for name, (_, purpose) in part.items()}
    assert {name: (command.help or "").split("\n")[0] for name, command in commands.items()} == told
    for name, command in list(commands.items()):
        if isinstance(command, typer.core.TyperGroup):
            commands |= {f"{name} {inner}": part for inner, part in command.commands.items()}
    for name, command in commands.items():
        assert command.help, name
        assert (command.epilog or "").startswith(f"Example: palpate {name} "), name
        for parameter in command.params:
            assert getattr(parameter, "help", None), f"{name} {parameter.name}"
