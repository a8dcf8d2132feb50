"""The versions of an amended protocol, read from a dataset; the rules of each are applied to its own sessions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from palpate.analysis.reading.study import ALL_TASKS, Exclusion, Unasked, Version, exclude
from palpate.experiment.errors import DatasetError

if TYPE_CHECKING:
    from palpate.experiment.protocol.models import Protocol


def read_versions(root: Path, facts: Mapping[str, Any]) -> tuple[Version, ...]:
    """Return the versions of an amended protocol, oldest first; none where it was not amended.

    Raises `DatasetError` for a session in two versions, and for what is no such list.
    """
    if not (stated := facts.get("Versions")):
        return ()
    from palpate.experiment.protocol import files

    try:
        listed = [(str(one["Protocol"]), [str(name) for name in one["Sessions"]]) for one in stated]
        sessions = [frozenset(tuple(one.removeprefix("sub-").split("_task-")) for one in own) for _, own in listed]
    except (KeyError, TypeError) as error:
        path = root / "dataset_description.json"
        raise DatasetError(path, "Versions is missing Protocol or Sessions", "rebuild the dataset") from error
    for session, times in Counter(one for own in sessions for one in own).items():
        if times > 1:
            raise _other_sessions(f"sub-{session[0]}_task-{session[1]} in {times} versions", root)
    return tuple(
        Version(file, files.load(root / "sourcedata" / Path(file).name), own)  # type: ignore[arg-type]
        for (file, _), own in zip(listed, sessions, strict=True)
    )


def of_people(versions: Iterable[Version], people: Mapping[tuple[str, str], str]) -> Iterator[Version]:
    """Yield versions with the persons of their sessions in place of labels."""
    for one in versions:
        yield replace(one, sessions=frozenset((people.get((who, task), who), task) for who, task in one.sessions))


def apply_rules(
    attempts: pd.DataFrame, withdrawn: Mapping[str, bool], protocol: Protocol | None, versions: Sequence[Version]
) -> tuple[pd.DataFrame, tuple[Exclusion, ...], tuple[Unasked, ...]]:
    """Return the attempts with what is included by the rules of each session's own version, and what is not.

    Raises `DatasetError` for a session in no version.
    """
    if not versions:
        return attempts, *_by_rules(attempts, withdrawn, protocol)
    of = list(zip(attempts["participant"], attempts["task"], strict=True))
    if missing := set(of).difference(*(version.sessions for version in versions)):
        raise _other_sessions(f"sub-{min(missing)[0]}_task-{min(missing)[1]} in none")
    present, parts = set(attempts["participant"]), []
    for version in versions:
        own = attempts[[session in version.sessions for session in of]].copy()
        latest = version is versions[-1]
        among = set(own["participant"])
        there = {who: gone for who, gone in withdrawn.items() if who in among}
        there |= {who: gone for who, gone in withdrawn.items() if latest and who not in present}
        parts.append((own, *_by_rules(own, there, version.protocol)))
    pooled = pd.concat([own for own, _, _ in parts]).sort_index()
    exclusions = tuple(dict.fromkeys(one for _, found, _ in parts for one in found))
    whole = {one.participant for one in exclusions if one.task == ALL_TASKS}
    pooled.loc[pooled["participant"].isin(whole), "included"] = False
    return pooled, exclusions, tuple(one for *_, found in parts for one in found)


def _other_sessions(got: str, root: Path = Path()) -> DatasetError:
    path, allowed = root / "dataset_description.json", "each session in one version"
    return DatasetError(path, f"got {got}", "rebuild the tables", field="Palpate.Versions", allowed=allowed)


def _by_rules(
    attempts: pd.DataFrame, withdrawn: Mapping[str, bool], protocol: Protocol | None
) -> tuple[tuple[Exclusion, ...], tuple[Unasked, ...]]:
    rules = protocol.exclusion if protocol else ()
    with_objects = [task.id for task in protocol.tasks if task.stimulus == "real"] if protocol else []
    return exclude(attempts, withdrawn, rules, with_objects=with_objects)
