"""Every command that starts a process runs in a laboratory's working folder as anywhere, and imports nothing of it.

Practice, the console, a served one and the participant's screen do so in tests of their own (`working_folder`).
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from palpate.analysis import published
from palpate.experiment.protocol.files import shipped
from tests.working_folder import WorkingFolder

pytestmark = pytest.mark.clocked

SESSION = "footstep/sourcedata/sub-01/sub-01_task-virtual"
PAPER = Path(published.__file__).with_name("wellman1995.toml")
RIGS = shipped("rigs/headless.toml").resolve().parent

NUMERICS = """\
from palpate.analysis.numerics import numerics
from palpate.experiment.__main__ import main
from palpate.experiment.errors import PalpateError
def run(extent, **reports):
    raise PalpateError("measured nothing")
numerics.run = run
main()
"""
"""The command up to its first measurement: it starts no process, and takes half a minute."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> WorkingFolder:
    """The folder, with the rehearsal of a study of each kind in it, that of taps with a fourth of its trials."""
    made = WorkingFolder(tmp_path_factory.mktemp("lab"))
    taps = shipped("wellman1995.toml").read_text("utf-8")
    for whole, fourth in (("repetitions = 8 ", "repetitions = 2 "), ("limit = 108", "limit = 27")):
        assert whole in taps
        taps = taps.replace(whole, fourth)
    (made.path / "taps.toml").write_text(taps, "utf-8")
    for study, out in (("okamoto2012", "footstep"), ("taps.toml", "tapping")):
        done = made.run("palpate", "rehearse", study, "--participants", 1, "--seed", 1, "--jobs", 2, "--out", out)
        assert (done.returncode, made.imported) == (0, []), done.stderr
    return made


@pytest.mark.parametrize(
    "command",
    [
        "check okamoto2012",
        "schedule okamoto2012 --participant 01 --seed 1",
        "power okamoto2012 --model okamoto2012 --participants 3 --studies 1001 --jobs 2",
        f"journal {SESSION}_journal.jsonl",
        "status footstep",
        "verify footstep",
        "analyse footstep --no-figures",
        "export footstep --out tables",
        f"audit {PAPER}",
    ],
)
def test_a_command_runs(folder: WorkingFolder, command: str) -> None:
    done = folder.run("palpate", *command.split())
    assert (done.returncode, done.stdout != "", folder.imported) == (0, True, []), done.stderr


def test_a_plan_opens_a_sound_card(folder: WorkingFolder) -> None:
    if shutil.which("jackd") is None:
        pytest.skip("needs JACK (package jackd2)")
    done = folder.run("palpate", "plan", "okamoto2012", "--task", "virtual", "--rig", RIGS / "headless.toml")
    assert (done.returncode, " modules, ready after " in done.stdout, folder.imported) == (0, True, []), done.stderr


def test_a_rig_for_tapping_is_checked_with_its_force_device(folder: WorkingFolder) -> None:
    done = folder.run("palpate", "doctor", "--rig", RIGS / "tapping.toml", "--protocol", "wellman1995", "--json")
    measured = {check["name"]: check["measured"] for check in json.loads(done.stdout)["checks"]}
    # Whether this machine is fast enough is no matter here.
    assert "messages" in measured["force rate"]
    assert folder.imported == []


def test_numerics_loads_all_that_it_needs(folder: WorkingFolder) -> None:
    done = folder.run("python", "-P", "-c", NUMERICS, "numerics", "--quick")
    last = done.stderr.splitlines()[-1]
    assert (done.returncode, last, folder.imported) == (2, "palpate: measured nothing", [])
