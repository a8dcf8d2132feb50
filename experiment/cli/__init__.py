"""What a person types: `palpate` and its commands, each of which imports what it needs when it is called.

This module imports next to nothing, so that `palpate --help` is there at once.
"""

import os
import sys
from contextlib import suppress

COMMANDS = {
    "Plan a study": {
        "new": ("protocol", "Write a new protocol, with a comment for every key."),
        "check": ("protocol", "Show a protocol to an ethics board."),
        "power": ("analysis", "Estimate how many participants a study needs."),
        "plan": ("recordings", "Print what a task needs and what it leaves out."),
        "rehearse": ("laboratory", "Run a whole study with simulated participants."),
        "seal": ("protocol", "Record the board's approval of a protocol."),
        "schema": ("protocol", "Write the JSON Schema of a protocol, a rig or results."),
        "preregister": ("protocol", "Write a protocol's plan for a preregistration at OSF."),
    },
    "Prepare a rig": {
        "devices": ("rig", "List the devices of this machine."),
        "calibrate": ("rig", "Calibrate a device of the rig."),
        "doctor": ("rig", "Check a rig before a session."),
    },
    "Record materials": {
        "record": ("recordings", "Record a protocol's materials and the bare panel."),
        "validate": ("recordings", "Validate the synthesis on recordings, as published."),
        "spectrum": ("recordings", "Print the spectrum of a recording, and plot it with --plot."),
        "tap": ("tap", "Fit recorded taps, and compute an impact on a virtual block."),
    },
    "Run sessions": {
        "enrol": ("laboratory", "Enrol the next participant of a study."),
        "amend": ("board", "Record an amendment, a renewal or a suspension of a study, or its end."),
        "incident": ("board", "Record an adverse event or a deviation from the protocol."),
        "consent": ("laboratory", "Record the consent of an enrolled participant."),
        "facts": ("laboratory", "Record what a participant tells of themselves, or correct it."),
        "person": ("laboratory", "Ask for a participant's name, and store it outside of every dataset."),
        "schedule": ("laboratory", "Print the trials of one participant, in order."),
        "run": ("session", "Run a participant's visit, or the rest of one."),
        "desk": ("desk", "Do a study's usual steps from one screen."),
        "screen": ("desk", "Open the participant's screen of a session."),
        "status": ("analysis", "Say how far a study is, and what is to be done next."),
        "journal": ("laboratory", "Verify a journal and print it as text."),
        "answers": ("laboratory", "Have a second person listen to spoken answers."),
        "withdraw": ("laboratory", "Record that a participant withdrew."),
        "build": ("laboratory", "Rebuild a dataset's tables from its journals."),
        "anchor": ("laboratory", "Anchor a dataset in a register outside of it."),
        "verify": ("laboratory", "Say what is proven of a dataset, and what is not."),
    },
    "Analyse": {
        "analyse": ("analysis", "Make the tables and the report of a dataset."),
        "export": ("analysis", "Write tables for R, JASP and PsychoPy users."),
        "share": ("board", "Write a copy of a dataset for others, of those who agreed."),
        "audit": ("analysis", "Check whether printed numbers agree with one another or a dataset."),
        "import-counts": ("analysis", "Make a dataset from counts, printed or measured."),
        "import-trials": ("analysis", "Make a dataset from another program's files of trials."),
        "numerics": ("analysis", "Measure error against run time of every way to compute a stimulus."),
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
        "  -h, --help  Show this message, or the options of the command that it follows.",
        "  --install-completion  Have Tab complete commands and options in this shell.",
        "",
        "Without a command, in an empty folder or one with a protocol: the desk, for a study's usual steps.",
    ]
    for heading, part in COMMANDS.items():
        lines += ["", f"{heading}:", *(f"  {name:13}  {purpose}" for name, (_, purpose) in part.items())]
    return "\n".join(lines) + "\n"
