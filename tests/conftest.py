"""Fixtures for every test, and the rule that CI skips nothing but what needs recordings that the repository lacks."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import settings
from syrupy.assertion import SnapshotAssertion
from syrupy.extensions.amber import AmberSnapshotExtension

from tests.approved import Approved, E, Refuses, refusal

# As in the command, and before any test imports numpy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Otherwise each command that a test starts would compile palpate for itself.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# As in a shell; the command sets it for its own processes.
os.environ.pop("PYTHONSAFEPATH", None)

# The same cases on every run, however busy the machine: a failure can be repeated, and none is one of time.
settings.register_profile("palpate", deadline=None, derandomize=True)
settings.load_profile("palpate")

REPOSITORY = Path(__file__).parent.parent
REQUIRE_ALL = os.environ.get("PALPATE_REQUIRE") == "all"

LONGEST = (
    "tests/faults/test_campaign.py",
    "tests/test_wings.py",
    "tests/test_house.py",
    "tests/portable/test_windows.py",
    "tests/rig/test_rehearsal.py",
    "tests/faults/test_pool.py",
    "tests/rig/test_practice.py",
    "tests/rig/test_rehearsal_refusals.py",
    "tests/portable/test_macos.py",
    "tests/rig/test_console.py",
    "tests/rig/test_desk.py",
    "tests/analysis/power/test_power.py",
    "tests/analysis/documents/test_figures.py",
    "tests/analysis/numerics/test_numerics.py",
    "tests/experiment/synthesis/test_bounds.py",
    "tests/rig/test_firmware.py",
    "tests/rig/test_tapping.py",
    "tests/rig/test_run_refusals.py",
    "tests/rig/test_levels.py",
    "tests/test_package.py",
    "tests/test_library.py",
)
"""Modules that take a quarter of a minute or more, longest first: one that began last would run alone at the end."""

NO_RECORDINGS = "needs the real recordings in ../shared/recordings, which are not in the repository"
"""The one reason for which a test may be skipped under PALPATE_REQUIRE=all."""


@pytest.fixture
def approved(snapshot: SnapshotAssertion, monkeypatch: pytest.MonkeyPatch) -> SnapshotAssertion:
    """What was approved of the text that a test compares with it; no terminal's width ends its lines."""
    monkeypatch.setenv("COLUMNS", "2000")
    return snapshot.use_extension(Approved)


@pytest.fixture
def refuses(request: pytest.FixtureRequest, snapshot: SnapshotAssertion) -> Refuses:
    """Expects an error of a class, and compares what it says with what was approved for this test."""
    approved = snapshot.use_extension(AmberSnapshotExtension)
    folder = request.getfixturevalue("tmp_path") if "tmp_path" in request.fixturenames else REPOSITORY

    @contextmanager
    def refused(kind: type[E]) -> Iterator[pytest.ExceptionInfo[E]]:
        with pytest.raises(kind) as error:
            yield error
        assert refusal(error.value, folder) == approved

    return refused


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest modules start first, and the others keep their order; `--no-loadscope-reorder` respects it."""
    rank = {REPOSITORY / module: place for place, module in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path, len(rank)))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Nothing that is imported or collected is garbage, and the collector never walks over it."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """With PALPATE_REQUIRE=all, a test that would be skipped fails instead, unless real recordings are absent."""
    report = yield
    allowed = NO_RECORDINGS in str(report.longrepr)
    if REQUIRE_ALL and report.skipped and not allowed and not hasattr(report, "wasxfail"):
        report.outcome = "failed"
        report.longrepr = f"PALPATE_REQUIRE=all forbids skipping: {report.longrepr}"
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """The same for a module that skips itself while it is collected."""
    report = yield
    if REQUIRE_ALL and report.skipped:
        report.outcome = "failed"
        report.longrepr = f"PALPATE_REQUIRE=all forbids skipping: {report.longrepr}"
    return report


def _skip_fsync(patch: pytest.MonkeyPatch) -> None:
    """`os.fsync` does nothing: what a test reads back need not outlive a power cut."""
    patch.setattr(os, "fsync", lambda descriptor: None)


@pytest.fixture(scope="module", autouse=True)
def _fsync(request: pytest.FixtureRequest) -> Iterator[None]:
    """Only tests of the rig, of faults and of the modules marked `fsync` wait for the disk."""
    folder, *_ = request.path.relative_to(REPOSITORY / "tests").parts
    with pytest.MonkeyPatch.context() as patch:
        if folder not in ("rig", "faults") and request.node.get_closest_marker("fsync") is None:
            _skip_fsync(patch)
        yield


@pytest.fixture(autouse=True)
def _as_in_a_shell() -> Iterator[None]:
    """A command that ran in this process hears no Ctrl-C and has a safe path; the tests after it are as before it."""
    before = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, before)
    os.environ.pop("PYTHONSAFEPATH", None)


@pytest.fixture
def no_process_stays() -> Iterator[None]:
    """What a test starts has ended with it; the pool of workers that a test before it left may stay."""
    before = {one.pid for one in multiprocessing.active_children()}
    yield
    assert {one.pid for one in multiprocessing.active_children()} <= before


@pytest.fixture
def without_fsync(monkeypatch: pytest.MonkeyPatch) -> None:
    """One test of a module marked `fsync` that writes too often to wait for the disk."""
    _skip_fsync(monkeypatch)


@pytest.fixture(scope="session")
def repository_root() -> Path:
    """The checkout."""
    return REPOSITORY


@pytest.fixture(scope="session")
def reference() -> Path:
    """The folder of what the papers print, one CSV file a table."""
    return REPOSITORY / "tests" / "reference"


@pytest.fixture(scope="session")
def real_recordings() -> Path:
    """The folder of other people's recordings beside the checkout; a clone alone has none."""
    path = REPOSITORY.parent / "shared" / "recordings"
    if not path.is_dir():
        pytest.skip(NO_RECORDINGS)
    return path


Palpate = Callable[..., tuple[int, str, str]]
"""Calls the command with these arguments; returns exit code, standard output and standard error."""


@pytest.fixture
def palpate(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Palpate:
    """The command, in this process."""
    from palpate.experiment import __main__

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["palpate", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            __main__.main()
        out, err = capsys.readouterr()
        return int(end.value.code or 0), out, err

    return call


@pytest.fixture
def seed_for() -> Callable[[Path, str], int]:
    """A seed under which participant 01 of a protocol does a task first."""
    from palpate.experiment.protocol import files
    from palpate.experiment.study.schedule import allocate

    def find(protocol_file: Path, task: str) -> int:
        protocol = files.load(protocol_file)
        return next(seed for seed in range(100) if allocate(protocol, seed)[0].tasks[0] == task)

    return find
