"""What is installed, from a wheel or a checkout: one package, beside a lab's own `analysis.py` and `experiment.py`."""

from __future__ import annotations

import ast
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import pytest

import palpate
from palpate.experiment.cli import docs

INSIDE = {
    "palpate": "palpate",
    "experiment": "palpate/experiment",
    "analysis": "palpate/analysis",
    "protocols": "palpate/experiment/shipped",
    "participants/README.md": "palpate/participants/README.md",
}
"""Folders and a file of the repository that a wheel contains, and where."""

LINKS = {"palpate/experiment": "../experiment", "palpate/analysis": "../analysis"}

METADATA_FOLDER = f"palpate-{palpate.__version__}.dist-info"

METADATA = {"METADATA", "RECORD", "WHEEL", "entry_points.txt", "licenses/LICENSE"}

OWN = 'print("a lab\'s own", __name__)\n'

NOTEBOOK = """
import inspect, json, multiprocessing, pickle, sys
import analysis, experiment

if __name__ == "__main__":
    from joblib import Parallel, delayed

    import palpate.analysis.analyse
    from palpate.experiment.protocol import files

    path = files.named("okamoto2012")
    protocol = files.load(path)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        spawned = pool.apply(files.load, (path,)), pool.apply(inspect.getsourcefile, (files.load,))
    work = [delayed(files.load)(path), delayed(inspect.getsourcefile)(files.load)]
    loky = Parallel(n_jobs=2, backend="loky")(work)
    report = {
        "files": {name: module.__file__ for name, module in sys.modules.items() if name.split(".")[0] == "palpate"},
        "own": [analysis.__file__, experiment.__file__],
        "equal": [protocol == other for other in (pickle.loads(pickle.dumps(protocol)), spawned[0], loky[0])],
        "workers": [spawned[1], loky[1]],
    }
    print(json.dumps(report))
"""


def call(*command: str | Path, cwd: Path) -> str:
    """Return what a command writes to standard output, without the settings of the Python that runs the tests."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


def tracked(root: Path, *folders: str) -> list[PurePosixPath]:
    """Return the files of the working tree, links included, that git tracks or would track."""
    listed = call("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", *folders, cwd=root)
    return [PurePosixPath(name) for name in sorted(set(listed.split("\0"))) if name and os.path.lexists(root / name)]


def build(source: Path, out: Path, *targets: str) -> None:
    call(
        sys.executable, "-m", "hatchling", "build", *(f"--target={target}" for target in targets), "-d", out, cwd=source
    )


def record(wheel: Path) -> str:
    """Return the list of a wheel's entries, with a hash of each."""
    with zipfile.ZipFile(wheel) as archive:
        return archive.read(f"{METADATA_FOLDER}/RECORD").decode("utf-8")


@dataclass(frozen=True)
class Installed:
    """An environment that has palpate and borrows every dependency.

    Attributes:
        scripts: the folder of its commands.
        site: its site-packages.
        checkout: the checkout that is installed; None for a wheel.
    """

    scripts: Path
    site: Path
    checkout: Path | None

    def files(self, module: str) -> tuple[str, str]:
        """Return the two files that a module may be loaded from: its own, or that of a package."""
        inner = module if self.checkout is None or module == "palpate" else module.removeprefix("palpate.")
        path = (self.checkout or self.site) / inner.replace(".", "/")
        return f"{path}.py", f"{path}/__init__.py"


def install(folder: Path, source: Path, *, editable: bool) -> Installed:
    """Return a new environment with `source`, a wheel or a checkout, installed by pip without a network."""
    venv.create(folder, symlinks=True)
    paths = sysconfig.get_paths("venv", vars={"base": str(folder), "platbase": str(folder)})
    # Python processes no .pth file of a folder that such a file names: an editable palpate in there is not seen.
    borrowed = sorted({sysconfig.get_path("purelib"), sysconfig.get_path("platlib")})
    site = Path(paths["purelib"])
    (site / "borrowed.pth").write_text("\n".join(borrowed), "utf-8")
    options = ["--quiet", "--no-deps", "--no-index", "--no-build-isolation", "--no-compile", "--ignore-installed"]
    pip = [sys.executable, "-m", "pip", "--python", f"{paths['scripts']}/python", "install", *options]
    call(*pip, *(["--editable"] if editable else []), source, cwd=folder)
    return Installed(Path(paths["scripts"]), site, source if editable else None)


@pytest.fixture(scope="module")
def built(repository_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an sdist and a wheel of the checkout."""
    out = tmp_path_factory.mktemp("built")
    build(repository_root, out, "sdist", "wheel")
    return out


@pytest.fixture(scope="module")
def wheel(built: Path) -> Path:
    (path,) = built.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lab's folder with scripts of its own, which have the names of our folders."""
    folder = tmp_path_factory.mktemp("lab")
    for name, text in {"analysis.py": OWN, "experiment.py": OWN, "notebook.py": NOTEBOOK}.items():
        (folder / name).write_text(text, "utf-8")
    return folder


@pytest.fixture(scope="module")
def unlinked(repository_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clone without links, as Git for Windows makes it, with what the working tree has changed since."""
    folder = tmp_path_factory.mktemp("clone") / "palpate"
    call("git", "clone", "-q", "-c", "core.symlinks=false", repository_root, folder, cwd=folder.parent)
    changes = folder.parent / "changes"
    call("git", "diff", "--binary", f"--output={changes}", "HEAD", cwd=repository_root)
    if changes.stat().st_size:
        call("git", "apply", changes, cwd=folder)
    return folder


@pytest.fixture(scope="module", params=["wheel", "checkout", "clone without links"])
def installed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    sources = {"wheel": "wheel", "checkout": "repository_root", "clone without links": "unlinked"}
    source: Path = request.getfixturevalue(sources[request.param])
    return install(tmp_path_factory.mktemp("environment"), source, editable=request.param != "wheel")


def test_a_wheel_contains_palpate_and_nothing_beside_it(repository_root: Path, wheel: Path) -> None:
    expected = {
        str(inside / path.relative_to(folder))
        for folder, inside in INSIDE.items()
        for path in tracked(repository_root, folder)
        if str(path) not in LINKS
    }
    with zipfile.ZipFile(wheel) as archive:
        metadata = {f"{METADATA_FOLDER}/{name}" for name in METADATA}
        assert set(archive.namelist()) == expected | metadata


def test_a_wheel_of_the_source_archive_is_the_same(built: Path, wheel: Path, tmp_path: Path) -> None:
    (path,) = built.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        assert [member.name for member in archive if not member.isfile()] == []
        archive.extractall(tmp_path, filter="data")
    build(tmp_path / path.name.removesuffix(".tar.gz"), tmp_path, "wheel")
    (again,) = tmp_path.glob("*.whl")
    assert record(again) == record(wheel)


def test_the_commands_are_ours(installed: Installed, lab: Path) -> None:
    python, command = installed.scripts / "python", installed.scripts / "palpate"
    assert call(command, "--version", cwd=lab) == f"palpate {palpate.__version__}\n"
    assert call(python, "-m", "palpate.experiment", "--version", cwd=lab) == f"palpate {palpate.__version__}\n"


def test_every_guide_is_installed(installed: Installed, repository_root: Path, lab: Path) -> None:
    listed = call(installed.scripts / "palpate", "docs", "--path", cwd=lab).splitlines()
    texts = [Path(line.split(maxsplit=1)[1]).read_bytes() for line in listed]
    assert texts == [(repository_root / file).read_bytes() for file, _ in docs.GUIDES.values()]


def named_files(source: str) -> set[str]:
    """Return the files of a checkout that the texts of a module name, to whoever may have none.

    A docstring is read by programmers, unless a decorator makes it the help of a command.
    """
    tree = ast.parse(source)
    helps = {id(node.body[0]) for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.decorator_list}
    quiet = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr) and id(node) not in helps}
    texts = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in quiet]
    rooms = r"(?:experiment|analysis|tests|protocols|participants|palpate/guide)"
    file = rf"\b{rooms}/[\w./-]+\.(?:md|toml|csv)\b(?!` in palpate's repository)"
    return {name for text in texts if isinstance(text, str) for name in re.findall(file, text)}


@pytest.mark.parametrize(
    ("source", "named"),
    [
        ('raise PalpateError("see tests/README.md")', {"tests/README.md"}),
        ('"""Derived in `analysis/x.md`."""\ndef f():\n    """`tests/x.csv` has it."""\n', set()),
        ('@commands.command()\ndef f():\n    """See protocols/a.toml."""\n', {"protocols/a.toml"}),
        ('TEXT = "`tests/README.md` in palpate\'s repository shows how."', set()),
    ],
    ids=["error", "docstring", "help", "repository"],
)
def test_a_named_file_is_found(source: str, named: set[str]) -> None:
    assert named_files(source) == named


def test_no_error_or_help_names_a_file_that_only_a_checkout_has(repository_root: Path) -> None:
    """After a wheel's install guides and examples are named by their ids."""
    sources = [str(path) for path in tracked(repository_root, "experiment", "analysis") if path.suffix == ".py"]
    found = {name: named_files((repository_root / name).read_text("utf-8")) for name in sources}
    listed = found.pop("experiment/cli/docs.py")
    assert {name: files for name, files in found.items() if files} == {}
    assert listed == {file for file, _ in docs.GUIDES.values()}


def test_only_a_wheel_copies_modules(installed: Installed) -> None:
    own = "palpate" if installed.checkout is None else "_palpate.pth"
    assert {path.name for path in installed.site.iterdir()} == {"borrowed.pth", METADATA_FOLDER, own}


def test_a_notebook_uses_palpate_beside_modules_of_its_own(installed: Installed, lab: Path) -> None:
    """Pickles and worker processes too; and each module is loaded once, from where it is, never through a link."""
    report = json.loads(call(installed.scripts / "python", "notebook.py", cwd=lab).splitlines()[-1])
    assert report["own"] == [str(lab / "analysis.py"), str(lab / "experiment.py")]
    assert report["equal"] == [True, True, True]
    files = "palpate.experiment.protocol.files"
    assert {"palpate", files, "palpate.analysis.analyse"} <= set(report["files"])
    assert {module: file for module, file in report["files"].items() if file not in installed.files(module)} == {}
    assert set(report["workers"]) <= set(installed.files(files))


@pytest.mark.parametrize("installed", ["wheel", "clone without links"], indirect=True)
def test_a_study_is_rehearsed_beside_modules_of_a_lab(installed: Installed, lab: Path, tmp_path: Path) -> None:
    """The checkout is missing here because every other test runs it."""
    study = tmp_path / "study.toml"
    call(installed.scripts / "palpate", "new", study, "--yes", "--tasks", "real", "--repetitions", "1", cwd=lab)
    options = ["--participants", "1", "--jobs", "2", "--out", str(tmp_path / "out"), "--json"]
    assert json.loads(call(installed.scripts / "palpate", "rehearse", study, *options, cwd=lab))


@pytest.mark.parametrize("name", sorted(LINKS))
def test_git_has_links_and_no_folders(repository_root: Path, name: str) -> None:
    mode, sha, *_ = call("git", "ls-files", "--stage", name, cwd=repository_root).split()
    assert (mode, call("git", "cat-file", "blob", sha, cwd=repository_root)) == ("120000", LINKS[name])
    path = repository_root / name
    assert (str(path.readlink()) if path.is_symlink() else path.read_text("utf-8")) == LINKS[name]


@pytest.mark.parametrize(
    ("inside", "loaded"),
    [
        ("link", "experiment"),
        ("text", "experiment"),
        ("copy", "experiment"),
        ("nothing", "experiment"),
        ("wheel", "palpate/experiment"),
    ],
)
def test_only_a_wheel_loads_the_folders_inside_of_palpate(
    repository_root: Path, tmp_path: Path, inside: str, loaded: str
) -> None:
    """A copy is what unpacking an archive makes of a link. Beside a wheel there may be another's `experiment`."""
    root, link = tmp_path / "experiment", tmp_path / "palpate" / "experiment"
    root.mkdir()
    link.parent.mkdir()
    (root / "__init__.py").touch()
    shutil.copy(repository_root / "palpate" / "__init__.py", link.parent)
    match inside:
        case "link":
            link.symlink_to("../experiment")
        case "text":
            link.write_text("../experiment", "utf-8")
        case "copy":
            shutil.copytree(root, link)
        case "wheel":
            shutil.copytree(root, link)
            (link / "shipped").mkdir()
    found = call(sys.executable, "-c", "import palpate.experiment as e; print(e.__file__)", cwd=tmp_path)
    assert found.strip() == str(tmp_path / loaded / "__init__.py")


@pytest.mark.parametrize("name", ["experiment", "analysis"])
def test_our_folders_refuse_the_names_of_a_lab(name: str) -> None:
    """The root of a checkout is on the path, for whoever imports a module of their own that is missing."""
    with pytest.raises(ImportError) as refused:
        importlib.import_module(name)
    assert not isinstance(refused.value, ModuleNotFoundError)
    assert name not in sys.modules


@pytest.mark.parametrize(
    "line",
    [
        "import experiment",
        "import analysis.reading",
        "from experiment.records import journal",
        "import palpate.tests",
        "from palpate.palpate import experiment",
        "from palpate import tests",
    ],
)
def test_the_linter_refuses_names_that_only_a_checkout_has(repository_root: Path, line: str) -> None:
    options = ["--no-cache", "--output-format=json", "--stdin-filename=experiment/x.py"]
    ruff = [sys.executable, "-m", "ruff", "check", *options, "-"]
    done = subprocess.run(ruff, input=f"{line}\n", cwd=repository_root, capture_output=True, text=True, check=False)
    assert "TID251" in {found["code"] for found in json.loads(done.stdout)}


def test_no_text_names_what_only_a_checkout_has(repository_root: Path) -> None:
    """Modules that are imported by name, commands and documents too, which the linter does not read."""
    folders = [repository_root / "experiment", repository_root / "analysis"]
    rooms = "|".join(sorted({path.stem for folder in folders for path in folder.glob("[a-z]*")}))
    bare = rf"(?<![\w./-])(?:experiment|analysis)\.(?:{rooms})\b"
    only = re.compile(rf"palpate\.(?:tests|palpate)\b|-m\W{{1,5}}(?:experiment|analysis)\b|{bare}")
    planted = {"tests/experiment/apparatus/tracker/test_guarded.py", "tests/experiment/test_working_folder.py"}
    forbid = {"CHANGELOG.md", "pyproject.toml", "tests/test_package.py", *planted}
    paths = [path for path in tracked(repository_root) if path.suffix in {".py", ".md", ".toml", ".yaml"}]
    texts = {str(path): (repository_root / path).read_text("utf-8") for path in paths if str(path) not in forbid}
    assert {path: hits for path, text in texts.items() if (hits := only.findall(text))} == {}
