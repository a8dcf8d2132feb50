"""What a person types: `palpate` and its commands, each of which imports what it needs when it is called.

This module imports next to nothing, so that `palpate --help` is there at once.
"""

import os
import sys
from contextlib import suppress

COMMANDS = {
    "Plan a study": {
        "new": ("protocol", "Write a new protocol, with a comment for every key."),
        "check": ("protocol", "Show a protocol as its ethics board sees it."),
        "power": ("analysis", "Estimate how many participants a study needs."),
        "plan": ("recordings", "Print the resources that a task needs and what the rig leaves out of its stimuli."),
        "rehearse": ("laboratory", "Run a whole study with simulated participants."),
        "seal": ("protocol", "Record the board's approval of a protocol."),
        "schema": ("protocol", "Write the JSON Schema of a protocol, a rig or results."),
        "preregister": ("protocol", "Write a protocol's plan as an OSF preregistration."),
    },
    "Prepare a rig": {
        "devices": ("rig", "List the devices of this machine."),
        "calibrate": ("rig", "Calibrate a device of the rig."),
        "doctor": ("rig", "Check a rig before a session."),
    },
    "Record materials": {
        "record": ("recordings", "Record a protocol's materials and the bare panel."),
        "validate": ("recordings", "Validate the synthesis on recordings, as in the paper."),
        "spectrum": ("recordings", "Print the spectrum of a recording; plot it with --plot."),
        "tap": ("tap", "Fit recorded taps, or compute an impact on a virtual block."),
    },
    "Run sessions": {
        "enrol": ("laboratory", "Enroll the next participant of a study."),
        "amend": ("board", "Record a study's amendment, renewal, suspension or end."),
        "incident": ("board", "Record an adverse event or a deviation from the protocol."),
        "consent": ("laboratory", "Record the consent of an enrolled participant."),
        "facts": ("laboratory", "Record or correct a participant's answers about themselves."),
        "person": ("laboratory", "Store a participant's name outside all datasets."),
        "schedule": ("laboratory", "Print the trials of one participant, in order."),
        "run": ("session", "Run or resume a participant's visit."),
        "desk": ("desk", "Carry out a study's usual steps from one screen."),
        "screen": ("desk", "Open the participant's screen for a session."),
        "status": ("analysis", "Show a study's progress and its next step."),
        "journal": ("laboratory", "Verify a journal and print it as text."),
        "answers": ("laboratory", "Have a second person listen to spoken answers."),
        "withdraw": ("laboratory", "Record that a participant withdrew."),
        "build": ("laboratory", "Rebuild a dataset's tables from its journals."),
        "anchor": ("laboratory", "Anchor a dataset in a register outside it."),
        "verify": ("laboratory", "Show what a dataset proves and what it does not."),
    },
    "Analyze": {
        "analyse": ("analysis", "Make a dataset's tables and report."),
        "export": ("analysis", "Write tables for R, JASP and PsychoPy users."),
        "share": ("board", "Write a copy of a dataset to share, containing only participants who agreed."),
        "audit": ("analysis", "Check printed numbers against each other or against a dataset."),
        "import-counts": ("analysis", "Make a dataset from printed or measured counts."),
        "import-trials": ("analysis", "Make a dataset from another program's trial files."),
        "numerics": ("analysis", "Measure the error and run time of each way to compute a stimulus."),
    },
    "Read": {"docs": ("docs", "Show a guide, or list the guides that come with palpate.")},
}
"""For each command, in the order of a study: its module in this folder, and the first sentence of its help."""


def files_with(table: str) -> list[str]:
    """Return the readable TOML files of this folder with such a table: `study` in a protocol, `rig` in a rig file."""
    heads = (f"[{table}]", f"{table}.", f"{table} =")
    found = []
    for name in sorted(os.listdir()):  # noqa: PTH208
        if name.endswith(".toml") and os.path.isfile(name):  # noqa: PTH113
            with suppress(OSError), open(name, encoding="utf-8", errors="replace") as file:  # noqa: PTH123
                found += [name] if any(line.startswith(heads) for line in file) else []
    return found


def opens_desk() -> bool:
    """Return whether `palpate` alone opens the desk: at a terminal, in an empty folder or one with a protocol."""
    streams = (sys.stdin, sys.stdout, sys.stderr)
    at_terminal = all(stream is not None and stream.isatty() for stream in streams)
    return at_terminal and (not os.listdir() or bool(files_with("study")))  # noqa: PTH208


def tell(line: str) -> None:
    """Print a line on standard error; where that takes nothing, the exit code stands alone."""
    try:
        print(line, file=sys.stderr, flush=True)  # noqa: T201
    except OSError:
        # What could not be written would be tried again when Python ends, and change the exit code.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def was_interrupted(error: BaseException) -> bool:
    """Return whether an error is Ctrl-C, or what a loading library, pydantic or a class being made turned it into."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, KeyboardInterrupt):
            return True
        cause = cause.__cause__
    return type(error).__name__ == "SchemaError" and "KeyboardInterrupt" in str(error)


def overview() -> str:
    """Return what `palpate --help` prints."""
    lines = [
        "Usage: palpate [OPTIONS] COMMAND [ARGS]...",
        "",
        "  Run vibrotactile psychophysics: from an ethics-reviewed protocol to published tables.",
        "",
        "Options:",
        "  --version   Print the version.",
        "  -h, --help  Show this message, or the options of a command.",
        "  --install-completion  Let Tab complete commands and options in this shell.",
        "",
        "Without a command, palpate opens the desk (in an empty folder or one with a protocol).",
    ]
    for heading, part in COMMANDS.items():
        lines += ["", f"{heading}:", *(f"  {name:13}  {purpose}" for name, (_, purpose) in part.items())]
    return "\n".join(lines) + "\n"
