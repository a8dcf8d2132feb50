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
NOT_READ = "give what `palpate power PROTOCOL --json` printed"


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
            "Description": [Quoted(protocol.study.source), _open("what the study is for, in a few sentences")],
            "Hypotheses": [
                *(Quoted(one.question, item=True) for one in protocol.analysis),
                _open("which answer to each question you expect, and in which direction"),
            ],
        },
        "Design Plan": {
            "Study type": [
                Said(
                    "Experiment: within participants, who each do every task that is theirs, with trials in random "
                    "order. Nothing is assigned between participants but the order of tasks"
                    f"{' and their group' if getattr(protocol, 'groups', ()) else ''}."
                )
            ],
            "Blinding": [
                Said(
                    "Participants are not told which material a trial presents. Whoever lays out a real object knows "
                    "it. The order of a participant's tasks is concealed until their first session; an earlier look is "
                    "on record."
                )
            ],
            "Is there any additional blinding in this study?": [_open("of whoever analyses, say")],
            "Study design": tasks,
            "Randomization": [
                Said(
                    "A seed is drawn when the first participant enrols, and its salted hash is on record from then on. "
                    "Orders of tasks and trials are SHA-256 draws by that seed, the participant and the task."
                ),
                *procedure,
            ],
        },
        "Sampling Plan": {
            "Existing data": [_open("whether any data exist on the day of registration")],
            "Explanation of existing data": [_open("if there are any")],
            "Data collection procedures": [*page["Participants and consent"], _open("how participants are recruited")],
            "Sample size": list(_sample(protocol)),
            "Sample size rationale": list(_rationale(power, protocol.study.participants)),
            "Stopping rule": [
                Said(
                    f"Data collection ends with {count(protocol.study.participants, 'participant')}. Whoever withdraws "
                    "before completing can be replaced, in the same order of tasks."
                ),
                _open("what ends it earlier; planned looks (`palpate power --looks`), if any"),
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
                    "A trial that may have been felt and has no confirmed answer is repeated. Tests are of the "
                    "participants with trials in the tasks that they compare; nothing is imputed."
                )
            ],
            "Exploratory analysis": [
                Said("Every table that palpate analyse marks as ours, exploratory or descriptive, and no planned one.")
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
        yield _open("why so many; --power gives the result of `palpate power PROTOCOL --json`")
        return
    yield Said(
        f"{power['studies']} SIMULATED studies of each size were drawn with seed {power['seed']}, with answers from:"
    )
    yield Quoted(str(power["model"]))
    found = power["recommended"]
    enough = "no size that was tried" if found is None else count(found, "participant")
    sizes = {row["participants_planned"] for row in power["needed_rows"]}
    which = "As planned" if sizes == {planned} else "At the tried size that is nearest to the planned one"
    yield Said(f"A power of {power['target']:g} in all planned tests that reach it takes {enough}. {which}:")
    for row in power["needed_rows"]:
        reached = "no power is defined" if row["power_planned"] is None else f"power {row['power_planned']:.2f}"
        subject = f"{row['test']} of {named(str(row['of']))}, {row['tasks']}"
        yield Item(f"{subject}: {reached} with {count(row['participants_planned'], 'participant')}.")


def _indices(protocol: Protocol) -> Iterator[Block]:
    index = _index(protocol)
    yield Said(index) if index else _open("what is computed of a participant's answers: a mean or a threshold, say")


def _transformations(protocol: Protocol) -> Iterator[Block]:
    if _index(protocol):
        yield Said("Shares of answers of each participant, task and material; no other transformation is planned.")
    else:
        yield _open("what is done to answers before they are analysed, logarithms say, or nothing")


def _index(protocol: Protocol) -> str:
    """Return which share of answers is analysed; empty where it is none, as with levels that follow the answers."""
    leveled = any(task.levels for task in protocol.tasks)
    return "" if leveled else design_words(protocol.tasks[0]).index


def _criteria(protocol: Protocol) -> Iterator[Block]:
    for one in protocol.analysis:
        family = "P as the test gives it" if one.correction is None else f"P by Holm's method over the {one.correction}"
        yield Item(f"{one.test}, {' and '.join(one.tasks)}: alpha {number(one.alpha)}; {family}.")


def _power(path: Path, protocol: Protocol) -> Mapping[str, Any]:
    """Return what `palpate power --json` printed. Raises `ProtocolError`."""
    try:
        found = storage.json_of(storage.read_bytes(path))
        wanted = {"study", "studies", "seed", "model", "target", "recommended", "needed_rows"}
        if not wanted <= found.keys():
            raise ValueError("it lacks what power prints")
    except (OSError, ValueError, AttributeError) as error:
        why = storage.why(error) if isinstance(error, OSError | ValueError) else "no JSON object"
        raise ProtocolError(path, f"cannot be read ({why})", NOT_READ) from error
    if found["study"] != protocol.study.id:
        raise ProtocolError(path, f"is of the study {found['study']}", NOT_READ, allowed=protocol.study.id)
    return dict(found)
