"""A protocol's plan as text, in the order of the form "OSF Preregistration" (https://osf.io/prereg, headings of 2024).

What no field of a protocol states is marked TO BE FILLED IN.
"""

from collections.abc import Iterator, Mapping
from datetime import date
from pathlib import Path
from typing import Any

from palpate.experiment import storage
from palpate.experiment.errors import ProtocolError
from palpate.experiment.protocol import approval
from palpate.experiment.protocol.approval import sealing
from palpate.experiment.protocol.blocks import Block, Free, Item, Quoted, Said, count, facts, named, number
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.page import rendering, sections
from palpate.experiment.protocol.page.words import design_words

OPEN = sealing.UNFILLED
NOT_READ = "give the output of `palpate power PROTOCOL --json`"


def text(protocol: Protocol, file: Path, today: date, power: Path | None = None) -> str:
    """Return the plan of the protocol in `file`, in lines of at most 92 columns.

    `power` is what `palpate power --json` printed. Raises `ProtocolError` for one that cannot be read or is of another
    study, and for a seal that cannot be read.
    """
    plan = None if power is None else _power(power, protocol)
    page = dict(sections(protocol))
    state, seal = sealing.state(file, protocol, today)
    made = [f"Preregistration of the study {protocol.study.id}", "=" * rendering.WIDTH]
    made += rendering.lines(_version(protocol, state, seal))
    for part, questions in _form(protocol, page, plan).items():
        made += ["", part, "-" * rendering.WIDTH]
        for question, blocks in questions.items():
            made += ["", f"{question}:", *rendering.lines(blocks)]
    return "\n".join(made) + "\n"


def _version(protocol: Protocol, state: str, seal: approval.Seal | None) -> Iterator[Block]:
    yield facts(("SHA-256", approval.sha256(protocol)))
    yield Said(f"{state} Text behind a bar is quoted from the protocol.", indent="  ")
    if seal is not None:
        until = f"from {seal.approved_on} to {seal.expires_on}"
        yield facts(("Approval", Free(seal.approval_number)), ("Board", Free(seal.board)), ("Valid", until))


def _form(
    protocol: Protocol, page: Mapping[str, Iterator[Block]], power: Mapping[str, Any] | None
) -> dict[str, dict[str, list[Block]]]:
    """Return the parts of the form, each with its questions and what the protocol answers to them."""
    procedure = list(page["What a participant does"])
    tasks = list(page["Tasks"])
    return {
        "Study Information": {
            "Title": [Quoted(protocol.study.title)],
            "Description": [Quoted(protocol.study.source), _open("the purpose of the study, in a few sentences")],
            "Hypotheses": [
                *(Quoted(one.question, item=True) for one in protocol.analysis),
                _open("the answer that you expect to each question, including its direction"),
            ],
        },
        "Design Plan": {
            "Study type": [
                Said(
                    "Within-subjects experiment: each participant does all of their tasks, with trials in random "
                    "order. The only differences assigned between participants are the order of "
                    f"tasks{' and their group' if getattr(protocol, 'groups', ()) else ''}."
                )
            ],
            "Blinding": [
                Said(
                    "Participants are not told which material a trial presents. The person who lays out a real "
                    "object knows which one it is. The order of a participant's tasks is concealed until their first "
                    "session; if anyone looks earlier, this is recorded."
                )
            ],
            "Is there any additional blinding in this study?": [_open("for example, of the analyst")],
            "Study design": tasks,
            "Randomization": [
                Said(
                    "A seed is drawn when the first participant enrolls, and its salted hash is recorded from then "
                    "on. The orders of tasks and trials are derived from this seed, the participant and the task "
                    "with SHA-256."
                ),
                *procedure,
            ],
        },
        "Sampling Plan": {
            "Existing data": [_open("whether any data already exist on the day of registration")],
            "Explanation of existing data": [_open("if there are any")],
            "Data collection procedures": [*page["Participants and consent"], _open("how participants are recruited")],
            "Sample size": list(_sample(protocol)),
            "Sample size rationale": list(_rationale(power, protocol.study.participants)),
            "Stopping rule": [
                Said(
                    f"Data collection ends with {count(protocol.study.participants, 'participant')}. Participants who "
                    "withdraw early can be replaced; their replacements have the same order of tasks."
                ),
                _open("reasons to stop earlier; planned interim looks (`palpate power --looks`), if any"),
            ],
        },
        "Variables": {
            "Manipulated variables": [*page["Materials"], *page["Stimuli"]],
            "Measured variables": [*page["Answers"], *page["What is recorded"]],
            "Indices": list(_indices(protocol)),
        },
        "Analysis Plan": {
            "Statistical models": list(page["Planned analysis"]),
            "Transformations": list(_transformations(protocol)),
            "Inference criteria": list(_criteria(protocol)),
            "Data exclusion": list(page["Exclusion rules"]),
            "Missing data": [
                Said(
                    "A trial that may have been felt but has no confirmed answer is repeated. Each test includes the "
                    "participants who have trials in the tasks that it compares; no data are imputed."
                )
            ],
            "Exploratory analysis": [
                Said(
                    "Every table that `palpate analyse` marks as ours, exploratory or descriptive, but no planned "
                    "table."
                )
            ],
        },
        "Other": {"Other": [*page["Limits that protect the participant"], _open("anything else, or nothing")]},
    }


def _open(what: str) -> Said:
    return Said(f"{OPEN}: {what}.", indent="    ")


def _sample(protocol: Protocol) -> Iterator[Block]:
    yield Said(f"{count(protocol.study.participants, 'participant')}.")
    for task in protocol.tasks:
        yield Item(f"Task {task.id}: {count(task.participants, 'participant')}, {protocol.trials(task)} trials each.")


def _rationale(power: Mapping[str, Any] | None, planned: int) -> Iterator[Block]:
    if power is None:
        yield _open("the reason for this number; --power adds the result of `palpate power PROTOCOL --json`")
        return
    yield Said(
        f"For each sample size, {power['studies']} studies were SIMULATED with seed {power['seed']} and answers from:"
    )
    yield Quoted(str(power["model"]))
    found = power["recommended"]
    enough = "more than the largest size simulated" if found is None else count(found, "participant")
    sizes = {row["participants_planned"] for row in power["needed_rows"]}
    which = "As planned" if sizes == {planned} else "At the simulated size closest to the planned one"
    yield Said(f"A power of {power['target']:g} in all planned tests that can reach it requires {enough}. {which}:")
    for row in power["needed_rows"]:
        reached = "power is undefined" if row["power_planned"] is None else f"power {row['power_planned']:.2f}"
        subject = f"{row['test']}, {named(str(row['of']))}, {row['tasks']}"
        yield Item(f"{subject}: {reached} with {count(row['participants_planned'], 'participant')}.")


def _indices(protocol: Protocol) -> Iterator[Block]:
    index = _index(protocol)
    yield (
        Said(index) if index else _open("what is computed from a participant's answers, such as a mean or a threshold")
    )


def _transformations(protocol: Protocol) -> Iterator[Block]:
    if _index(protocol):
        yield Said(
            "Answers are converted to proportions for each participant, task and material. No other transformation "
            "is planned."
        )
    else:
        yield _open("any transformations of the answers before analysis, such as logarithms")


def _index(protocol: Protocol) -> str:
    """Return which share of answers is analysed; empty where it is none, as with levels that follow the answers."""
    leveled = any(task.levels for task in protocol.tasks)
    return "" if leveled else design_words(protocol.tasks[0]).index


def _criteria(protocol: Protocol) -> Iterator[Block]:
    for one in protocol.analysis:
        family = (
            "unadjusted P" if one.correction is None else (f"P adjusted by Holm's method across the {one.correction}")
        )
        yield Item(f"{one.test}, {' and '.join(one.tasks)}: alpha {number(one.alpha)}; {family}.")


def _power(path: Path, protocol: Protocol) -> Mapping[str, Any]:
    """Return what `palpate power --json` printed. Raises `ProtocolError`."""
    try:
        found = storage.json_of(storage.read_bytes(path))
        wanted = {"study", "studies", "seed", "model", "target", "recommended", "needed_rows"}
        if not wanted <= found.keys():
            raise ValueError("it is not the output of palpate power")
    except (OSError, ValueError, AttributeError) as error:
        why = storage.why(error) if isinstance(error, OSError | ValueError) else "not a JSON object"
        raise ProtocolError(path, f"cannot be read ({why})", NOT_READ) from error
    if found["study"] != protocol.study.id:
        raise ProtocolError(path, f"is for the study {found['study']}", NOT_READ, allowed=protocol.study.id)
    return dict(found)
