"""Small BIDS datasets for the tests, written by the project's own writer."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from palpate.experiment.dataset.bids import (
    DatasetText,
    Origin,
    TaskText,
    description,
    events,
    participants,
    write_files,
)
from palpate.experiment.records.software import Software

MATERIALS = ("glass", "sand", "snow")


def trial(number: int, presented: str, answered: str, **cells: object) -> dict[str, object]:
    """One counted attempt; `cells` replace or add columns."""
    return {
        "trial": number,
        "attempt": 1,
        "counted": True,
        "presented": presented,
        "answered": answered,
        "origin": "PARTICIPANT",
        **cells,
    }


def trials(answers: Iterable[tuple[str, str]], **cells: object) -> list[dict[str, object]]:
    """Counted attempts of (presented, answered), numbered from 1."""
    return [trial(number, shown, said, **cells) for number, (shown, said) in enumerate(answers, start=1)]


def compared(pairs: Iterable[tuple[str, str, str]], **cells: object) -> list[dict[str, object]]:
    """Counted comparisons of (first, second, answered), numbered from 1; `cells` add columns."""
    return [
        {"trial": number, "attempt": 1, "counted": True, "first": first, "second": second, "answered": said, **cells}
        for number, (first, second, said) in enumerate(pairs, start=1)
    ]


def write_dataset(
    root: Path,
    sessions: Mapping[str, Mapping[str, Sequence[Mapping[str, object]]]],
    *,
    study: str = "lab",
    origin: Origin = "PARTICIPANT",
    materials: Sequence[str] = MATERIALS,
    withdrawn: Sequence[str] = (),
    tasks: Sequence[str] = ("virtual", "real"),
    session_ids: Mapping[tuple[str, str], str] | None = None,
    answers: Sequence[str] | None = None,
    presented: Mapping[str, tuple[str, ...]] | None = None,
    kind: str | None = None,
    design: str | None = None,
    intervals: int | None = None,
) -> Path:
    """A dataset of participant -> task -> rows of its events; `session_ids` of participant and task.

    With `answers` its trials are comparisons, unless it has a `kind` and a `design`; `presented` are the materials of
    tasks that do not present all.
    """
    text = DatasetText(
        study=study,
        name="A study",
        origin=origin,
        license="CC0-1.0",
        authors=("Somebody", "Somebody else"),
        tasks=tuple(tasks),
        readme="A dataset for tests, made of answers that nobody gave. " * 4,
        software=Software("0", "5" * 64),
    )
    people = ({"participant_id": f"sub-{label}", "withdrawn": label in withdrawn} for label in sessions)
    write_files({**description(root, text), **participants(root, people, origin=origin)})
    for label, by_task in sessions.items():
        for task, rows in by_task.items():
            said = TaskText(
                id=task,
                title=f"The {task} task",
                description="A task.",
                instructions="Say what it is.",
                materials={material: f"some {material}" for material in materials},
                stimulus_presentation={"SoftwareName": "palpate"},
                origin=origin,
                session_id=(session_ids or {}).get((label, task)),
                kind=kind or ("footstep" if answers is None else "tapping"),
                design=design or ("identification" if answers is None else "comparison"),
                answers={answer: f"the {answer}" for answer in answers or ()},
                presented=(presented or {}).get(task),
                intervals=intervals,
            )
            write_files(events(root, label, said, [{**row, "origin": origin} for row in rows]))
    return root


def balanced(seed: int, repetitions: int = 4, materials: Sequence[str] = MATERIALS) -> list[dict[str, object]]:
    """A session in which the right answer is more likely than the others, the same for the same seed."""
    answers = []
    for i, shown in enumerate(materials):
        for k in range(repetitions):
            right = (seed * 7 + i * 3 + k * 5) % 4 != 0
            answers.append((shown, shown if right else materials[(i + 1 + k) % len(materials)]))
    return trials(answers)
