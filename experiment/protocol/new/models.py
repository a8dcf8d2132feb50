"""A new protocol after another: its id, title, number of participants, who answers, and recorded waveforms.

Of each kind of trial and design there is one study to begin from; the copy keeps the comments of its model.
"""

import hashlib
import io
import wave
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomlkit

from palpate.experiment import storage
from palpate.experiment.errors import PalpateError
from palpate.experiment.protocol import files
from palpate.experiment.protocol import new as writing
from palpate.experiment.protocol.rules import OWN_ANSWERS
from palpate.experiment.settings.characters import plain, quoted

MODELS: Mapping[str, str] = {
    "footstep identification": "",
    "presented identification": "presented",
    "presented detection": "threshold",
    "presented comparison": "harder",
    "presented rating": "rating",
    "tapping comparison": "wellman1995",
}
"""Kind of trial and design, and the study that a new one begins from; none where questions make it."""

KINDS = tuple(MODELS)


def model(kind: str) -> Path | None:
    """Return the study to begin from of a kind of trial and design, or the first of either; None if questions make it.

    Raises `PalpateError` for what has none.
    """
    known = [name for of, name in MODELS.items() if kind in (of, *of.split(" "))]
    if not known:
        raise PalpateError(f"got {quoted(kind)}", allowed=f"one of: {', '.join(MODELS)}")
    return files.shipped(f"{known[0]}.toml") if known[0] else None


@dataclass(frozen=True)
class Recording:
    """A WAV file that a new study presents: its bytes, and how long it lasts, s."""

    file: Path
    content: bytes
    lasts_s: float


def recordings(paths: Sequence[Path]) -> tuple[Recording, ...]:
    """Return WAV files, read. Raises `PalpateError` for what is none."""
    found = []
    for path in paths:
        try:
            content = path.read_bytes()
            with wave.open(io.BytesIO(content)) as opened:
                lasts_s = opened.getnframes() / opened.getframerate()
        except (OSError, wave.Error, EOFError, ZeroDivisionError) as error:
            raise PalpateError(plain(str(path), keep=""), f"cannot be read: {error}", allowed="a WAV file") from error
        found.append(Recording(path, content, lasts_s))
    return tuple(found)


def values(typed: Sequence[str] | None) -> dict[str, tuple[float, ...]]:
    """Return the values of each `ID=NUMBER,NUMBER,...`. Raises `PalpateError` for what is none."""
    found = {}
    for one in typed or ():
        name, _, numbers = one.partition("=")
        try:
            found[name.strip()] = tuple(map(float, numbers.split(",")))
        except ValueError as error:
            raise PalpateError(f"got --factor {quoted(one)}", allowed="ID=NUMBER,NUMBER,...") from error
    return found


@dataclass(frozen=True)
class Changes:
    """What a copy has of its own: participants, who answers, recordings, the acceleration of their full scale, and
    values of factors by their ids.
    """

    participants: int | None = None
    mode: str | None = None
    recorded: tuple[Recording, ...] = ()
    full_scale_m_s2: float = 10.0
    values: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


UNCHANGED = Changes()


def files_beside(file: Path, changed: Changes) -> dict[Path, bytes]:
    """Return the copies of recordings beside a protocol file, but of those that are there.

    Raises `PalpateError` where another file of that name is there.
    """
    made: dict[Path, bytes] = {}
    for one in changed.recorded:
        path = file.with_name(one.file.name)
        if path in made or (path.exists() and path.read_bytes() != one.content):
            name = plain(str(path), keep="")
            raise PalpateError(name, "this file already exists", "name another", allowed="a new file")
        made |= {} if path.exists() else {path: one.content}
    return made


def copied(source: Path, study_id: str, title: str | None = None, *, changed: Changes = UNCHANGED) -> str:
    """Return the text of the protocol `source` under another id and title, without its approval.

    Tasks have as many participants as the study, but one that had fewer has at most those. Where participants answer
    themselves, the format is one that has it. Recordings take the place of
    what an identification presents. Raises `ProtocolError` as `files.load`, and `PalpateError` for what the file would
    not be allowed to have.
    """
    known = files.load(source)
    if study_id == known.study.id:
        raise PalpateError(
            f"got the id {quoted(study_id)}",
            allowed=f"an id that differs from the one in {plain(str(source), keep='')}",
        )
    document = tomlkit.parse(storage.read_text(source).removeprefix("\ufeff"))
    document["study"]["id"] = study_id
    if title is not None and title != known.study.title:
        document["study"]["title"] = title
    for name in ("approval_number", "approved_on", "expires_on"):
        if getattr(known.ethics, name):
            document["ethics"].pop(name)
    if (participants := changed.participants) not in (None, known.study.participants):
        document["study"]["participants"] = participants
        for task, planned in zip(document["tasks"], known.tasks, strict=True):
            some = planned.participants < known.study.participants
            task["participants"] = min(participants, planned.participants) if some else participants
    if changed.mode not in (None, known.answers.mode):
        document["answers"]["mode"] = changed.mode
        if changed.mode != "oral":
            document["format"] = max(known.format, OWN_ANSWERS)
    if changed.recorded:
        _present(document, changed)
    _vary(document, changed)
    made = tomlkit.dumps(document)
    writing.check(made)
    return made


def _vary(document: Any, changed: Changes) -> None:
    """Give factors of a document other values, which have no names. Raises `PalpateError` for a factor it has not."""
    factors = {str(one["id"]): one for one in document.get("factors", ())}
    for name, numbers in changed.values.items():
        if name not in factors:
            known = ", ".join(factors) or "none (this study has no factors)"
            raise PalpateError(f"got --factor {quoted(name)}", allowed=known)
        factors[name]["values"] = list(numbers)
        factors[name].pop("names", None)


def _present(document: Any, changed: Changes) -> None:
    """Let each recording be a material of a document, named after its file."""
    recorded = changed.recorded
    tables: list[Any] = [one for one in document.values() if isinstance(one, Mapping) and "stimuli" in one]
    if not tables or not all("spoken" in one for one in document.get("materials", [{}])):
        raise PalpateError(
            "got --recording", allowed="--recording only together with --kind presented --design identification"
        )
    named = writing.materials([one.file.stem for one in recorded])
    tables[0]["stimuli"] = [
        {
            "material": of.name,
            "parts": [
                {
                    "recorded": {
                        "file": one.file.name,
                        "sha256": hashlib.sha256(one.content).hexdigest(),
                        "full_scale_m_s2": changed.full_scale_m_s2,
                        "lasts_s": one.lasts_s,
                    }
                }
            ],
        }
        for of, one in zip(named, recorded, strict=True)
    ]
    document["materials"] = [
        {"id": of.name, "key": str(number), "spoken": [of.name], "description": f"The recording {one.file.name}."}
        for number, (of, one) in enumerate(zip(named, recorded, strict=True), start=1)
    ]
    for task in document["tasks"]:
        task["title"] = "Recorded waveforms"
        task["instruction"] = "After each vibration, say which one it was."
        task["familiarisation"]["instruction"] = "Feel each vibration and hear its name until you know them all."
    for test in document["analysis"]:
        test["question"] = "Is each waveform named correctly more often than by chance?"
        if "chance" in test:
            test["chance"] = 1 / len(recorded)
