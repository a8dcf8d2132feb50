"""The portable part of palpate: every command that runs behind a mask, how it ends, and the known faults.

The `COMMANDS` of a system are typed one after the other in one folder. `FAULTS` is the one list of what does not work
yet. Whoever mends one takes it off the list, for a test fails as soon as a command on it works.

Not run here: `numerics`, for it takes half a minute of arithmetic; `run` and `desk` at a terminal, but for a session
that serves a console (`test_windows.py`); `screen`, for it waits for a session; and `doctor` with a simulated sound
card on macOS, for it starts a JACK server, as `tests/rig` does. What takes seconds, and asks nothing of macOS that
another command does not ask, runs on Windows alone.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from shutil import copy, copytree

WINDOWS, MACOS = "windows", "macos"


@dataclass(frozen=True)
class Command:
    """What is typed after `palpate`, and the exit codes with which it may end: 2 is a refusal in words."""

    line: str
    ends: tuple[int, ...] = (0,)
    systems: tuple[str, ...] = (WINDOWS, MACOS)
    keys: str = ""
    """What is typed while it runs, before the input ends."""


REFUSED = (2,)

GREEN_OR_RED = (0, 2)
"""A rig has red checks on a machine that is busy."""

COMMANDS = (
    Command("--version"),
    # Plan a study.
    Command(
        "new study.toml --yes --id steps --participants 2 --material paper --material foil --tasks virtual "
        "--repetitions 1 --rig rig.toml"
    ),
    Command("check study.toml"),
    Command("check study.toml --html page.html"),
    Command("check other-script.toml"),
    Command("check missing.toml", REFUSED),
    Command("new device.toml --yes --id aux", REFUSED),
    Command("new aux.toml --yes --id harmless", REFUSED, (WINDOWS,)),
    Command("power okamoto2012 --participants 5 --studies 20 --jobs 1"),
    Command("power okamoto2012 --participants 5 --studies 20 --jobs 2 --out power", systems=(WINDOWS,)),
    Command("plan okamoto2012 --task virtual", systems=(WINDOWS,)),
    Command("rehearse study.toml --participants 2 --seed 1 --jobs 2 --out rehearsed"),
    Command("rehearse taps.toml --participants 1 --seed 1 --jobs 1 --out tapped", systems=(WINDOWS,)),
    Command("schema rig --out rig.schema.json"),
    Command("docs"),
    Command("docs keys", systems=(WINDOWS,)),
    Command("seal okamoto2012.toml --approval-number 1 --approved-on 2026-01-01 --expires-on 2099-12-31"),
    # Prepare a rig, and record materials.
    Command("devices"),
    Command("doctor --rig rehearsal.toml", GREEN_OR_RED),
    Command("doctor --rig rig.toml", REFUSED),
    Command("doctor --rig headless.toml", REFUSED, (WINDOWS,)),
    Command("calibrate tracker --rig rig.toml --out calibrated.toml", REFUSED),
    Command("calibrate audio --rig rig.toml --out calibrated.toml", REFUSED),
    Command("record study.toml --simulated --out recordings"),
    Command("validate recordings --no-figures"),
    Command("spectrum recordings/000_panel_50_1.wav --plot spectrum.svg"),
    Command("tap fit recordings/000_panel_50_1.wav", (0, 1)),
    Command("tap contact --stiffness 2500 --damping 10 --mass 0.1 --speed 0.2 --plot tap.svg"),
    # Run sessions.
    Command("enrol okamoto2012.toml --participant 01 --consent-on 2026-05-04 --dataset enrolled"),
    Command("consent okamoto2012.toml -p 01 --consent-on 2026-05-05 --correct --reason slip --dataset enrolled"),
    Command("person okamoto2012.toml -p 01 --show --dataset enrolled"),
    Command("schedule okamoto2012.toml --participant 01 --dataset enrolled"),
    Command("run okamoto2012.toml -p 01 --rig rig.toml --lines --dataset enrolled", REFUSED),
    Command("run study.toml --practice --lines", keys="\n"),
    Command("run taps.toml --practice --lines --task virtual", REFUSED, (WINDOWS,)),
    Command("run taps.toml --practice --lines --task virtual", systems=(MACOS,), keys="\n"),
    Command("run study.toml --practice --serve 127.0.0.1", REFUSED, (WINDOWS,)),
    Command("desk rehearsed", REFUSED),
    Command("status rehearsed"),
    Command("journal rehearsed/sourcedata/sub-01/sub-01_task-virtual_journal.jsonl"),
    Command("answers review rehearsed --list"),
    Command("build rehearsed"),
    Command("anchor rehearsed --to register.jsonl"),
    Command("verify rehearsed --register register.jsonl"),
    Command("withdraw okamoto2012.toml -p 01 --reason 'asked to stop' --dataset enrolled"),
    Command("withdraw okamoto2012.toml -p 01 --reason 'asked to stop' --dataset enrolled --erase --yes"),
    # Analyse.
    Command("analyse rehearsed"),
    Command("export rehearsed --out exported"),
    Command("analyse published", systems=(WINDOWS,)),
    Command("export published --out exported-published"),
    Command("audit okamoto2012", systems=(WINDOWS,)),
    Command("audit wellman1995"),
    Command("import-counts --task real=counts.csv --study counted --source 'a table' --out counted"),
    Command("import-trials trials.csv --presented shown --answered said --participant who --study told --out told"),
    Command("analyse told --no-figures"),
)

FAULTS: dict[tuple[str, str], str] = {}
"""Commands that do not end as `COMMANDS` says, by system, and why."""


def commands(system: str) -> tuple[Command, ...]:
    """Return what is typed on a system, in order."""
    return tuple(command for command in COMMANDS if system in command.systems)


def lay_out(folder: Path, repository: Path) -> None:
    """Put into a folder the files that commands name and none of them makes."""
    protocols, published = repository / "protocols", repository / "participants"
    for file in ("okamoto2012.toml", "rigs/rehearsal.toml", "rigs/rehearsal-response.csv", "rigs/headless.toml"):
        copy(protocols / file, folder)
    copytree(published / "okamoto2012", folder / "published")
    copy(repository / "tests" / "reference" / "okamoto2012_counts_real.csv", folder / "counts.csv")
    text = (protocols / "okamoto2012.toml").read_text("utf-8")
    titled = re.sub(r'^title = ".*"', 'title = "触覚"', text, flags=re.MULTILINE)
    (folder / "other-script.toml").write_text(titled, "utf-8")
    text = (protocols / "wellman1995.toml").read_text("utf-8")
    shortened = text.replace("repetitions = 8", "repetitions = 2").replace("limit = 108", "limit = 27")
    (folder / "taps.toml").write_text(shortened, "utf-8")
    (folder / "trials.csv").write_text("who,shown,said\n1,felt,felt\n1,cork,felt\n2,felt,cork\n2,cork,cork\n", "utf-8")
