"""A throwaway branch: every format has its next number, one key of another name and one key or column more.

It is a copy of the checkout, changed as `CONTRIBUTING.md` says, in which `python -m tests.releases.next_formats` does
one of `ACTS` with a folder.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import palpate
from palpate.analysis.analyse import analyse
from palpate.experiment.dataset import build, verify
from palpate.experiment.rehearsal import study as rehearsal
from palpate.experiment.study.people import enrolling
from tests.experiment.dataset.studies import MadeStudy, make_study
from tests.experiment.protocol.asking import PEOPLE, SHARING, asking

ROOT = Path(__file__).parents[2]

SOURCES = ("palpate", "experiment", "analysis", "protocols", "tests")
LEFT = ("__pycache__", "guide", "benchmarks", "faults", "portable")

RENAMED = {
    "journal": ("task_position", "place_in_order"),
    "roster": ("told_on", "answered_on"),
    "protocol": ("voice_recordings", "keeps_sound"),
    "rig": ("trigger_m_s2", "starts_m_s2"),
    "manifest": ("achieved_mm_s", "measured_mm_s"),
    "seal": ("protocol", "approved_form"),
    "dataset": ("salt", "seed_salt"),
    "results": ("made_by", "written_by"),
}
"""The key of each format that has another name there."""

EVERYWHERE = ("journal", "roster", "protocol", "rig", "manifest")
"""Those whose key no other text of the source has as a word."""


@dataclass(frozen=True)
class Edit:
    """A change to one file: `new` in the place of `old`, wherever that stands."""

    file: str
    old: str
    new: str


def _alias(new: str, old: str) -> str:
    return f'Field(validation_alias=AliasChoices("{new}", "{old}"))'


_JOURNAL, _ROSTER, _SEALS = (
    "experiment/records/entries.py",
    "experiment/study/roster.py",
    "experiment/protocol/approval/",
)
_PROTOCOL, _RIG, _MANIFEST = (
    "experiment/protocol/models.py",
    "experiment/apparatus/rig.py",
    "experiment/recordings/manifest.py",
)
_ENROLMENT, _NAMES = "experiment/study/enrolment.py", "experiment/study/people/__init__.py"
_PAGE = "analysis/documents/page.py"

EDITS = (
    Edit(_JOURNAL, "FORMAT: Literal[10] = 10", "FORMAT: Literal[11] = 11"),
    Edit(_JOURNAL, "format: Literal[9, 10]", "format: Literal[9, 10, 11]"),
    Edit(_JOURNAL, "import AfterValidator", "import AliasChoices, AfterValidator"),
    Edit(
        _JOURNAL,
        "    place_in_order: int\n",
        f"    place_in_order: int = {_alias('place_in_order', 'task_position')}\n",
    ),
    Edit(
        _JOURNAL, "    floor_m_s2: float | None = None\n", "    floor_m_s2: float | None = None\n    room: str = 'a'\n"
    ),
    Edit(_ROSTER, "FORMAT: Literal[2] = 2", "FORMAT: Literal[3] = 3"),
    Edit(_ROSTER, "format: Literal[1, 2]", "format: Literal[1, 2, 3]"),
    Edit(_ROSTER, "from pydantic import Field", "from pydantic import AliasChoices, Field"),
    Edit(_ROSTER, "    answered_on: date\n", f"    answered_on: date = {_alias('answered_on', 'told_on')}\n"),
    Edit(_ROSTER, "    agreed: bool\n", "    agreed: bool\n    asked_by: str | None = None\n"),
    Edit(f"{_SEALS}__init__.py", "Format = Literal[1]", "Format = Literal[1, 2]"),
    Edit(f"{_SEALS}__init__.py", "FORMAT: Format = 1", "FORMAT: Format = 2"),
    Edit(f"{_SEALS}__init__.py", "    protocol: Text\n", "    approved_form: Text\n    room: Text = 'a'\n"),
    Edit(
        f"{_SEALS}__init__.py",
        "    RULES: ClassVar[Rules] = rules.ethics\n\n",
        "    RULES: ClassVar[Rules] = rules.ethics\n\n"
        "    @classmethod\n"
        "    def renewed(cls, document: Any) -> Any:\n"
        '        return {{"protocol": "approved_form"}.get(key, key): value for key, value in document.items()}\n\n',
    ),
    Edit(f"{_SEALS}__init__.py", "seal.protocol.", "seal.approved_form."),
    Edit(f"{_SEALS}__init__.py", "seal.protocol)", "seal.approved_form)"),
    Edit(f"{_SEALS}sealing.py", "seal.protocol)", "seal.approved_form)"),
    Edit(f"{_SEALS}sealing.py", '"protocol": canonical', '"approved_form": canonical'),
    Edit(
        f"{_SEALS}__init__.py",
        "    for *tables, key in load.younger",
        "    if protocol.format < 8:\n"
        '        document["consent"]["voice_recordings"] = document["consent"].pop("keeps_sound")\n'
        "    for *tables, key in load.younger",
    ),
    Edit(_PROTOCOL, "format: Literal[2, 3, 4, 5, 6, 7]", "format: Literal[2, 3, 4, 5, 6, 7, 8]"),
    Edit(
        _PROTOCOL,
        "    spoken: tuple[Name, ...] = ()\n",
        "    spoken: tuple[Name, ...] = ()\n    color: str | None = Field(None, json_schema_extra={'since': 8})\n",
    ),
    Edit(
        _PROTOCOL,
        "        return module.renewed(document) if (module := written_as(document)) else document\n",
        "        made = module.renewed(document) if (module := written_as(document)) else document\n"
        '        names = {"voice_recordings": "keeps_sound"} if document.get("format") != 8 else {}\n'
        '        consent = made.get("consent")\n'
        "        if not isinstance(consent, Mapping):\n"
        "            return made\n"
        '        return {**made, "consent": {names.get(key, key): value for key, value in consent.items()}}\n',
    ),
    Edit(_RIG, "format: Literal[1, 2, 3, 4, 5, 6]", "format: Literal[1, 2, 3, 4, 5, 6, 7]"),
    Edit(
        _RIG,
        "    _folder: Path | None = PrivateAttr(None)\n    _site: str | None = PrivateAttr(None)\n\n    @property\n",
        "    room: str | None = Field(None, json_schema_extra={'since': 7})\n"
        "    _folder: Path | None = PrivateAttr(None)\n    _site: str | None = PrivateAttr(None)\n\n"
        "    @classmethod\n"
        "    def renewed(cls, document: Any) -> Any:\n"
        '        sensor = document.get("accelerometer")\n'
        "        if not isinstance(sensor, dict):\n"
        "            return document\n"
        '        names = {"trigger_m_s2": "starts_m_s2"}\n'
        '        return {**document, "accelerometer": {names.get(key, key): one for key, one in sensor.items()}}\n\n'
        "    @property\n",
    ),
    Edit(
        _RIG,
        "    own = rig.driver_file(rig.tracker.driver) if",
        '    if rig.format < 7 and "accelerometer" in stated:\n'
        '        stated["accelerometer"]["trigger_m_s2"] = stated["accelerometer"].pop("starts_m_s2")\n'
        "    own = rig.driver_file(rig.tracker.driver) if",
    ),
    Edit(_MANIFEST, "    format: Literal[1]\n", "    format: Literal[1, 2]\n"),
    Edit(_MANIFEST, '    unit: Literal["m/s^2"]\n', '    unit: Literal["m/s^2"]\n    room: Remark = ""\n'),
    Edit(
        _MANIFEST,
        "    takes: tuple[_Take, ...]\n",
        "    takes: tuple[_Take, ...]\n\n"
        "    @classmethod\n"
        "    def renewed(cls, document: Table) -> Table:\n"
        '        names = {"achieved_mm_s": "measured_mm_s"}\n'
        '        takes = [{names.get(key, key): one for key, one in take.items()} for take in document["takes"]]\n'
        '        return {**document, "takes": tuple(takes)}\n',
    ),
    Edit(_MANIFEST, "Name, Remark\n", "Name, Remark, Table\n"),
    Edit("experiment/recordings/store.py", '"format = 1"', '"format = 2"'),
    Edit("experiment/storage.py", "DatasetFormat = Literal[2]", "DatasetFormat = Literal[2, 3]"),
    Edit("experiment/storage.py", "DATASET_FORMAT: DatasetFormat = 2", "DATASET_FORMAT: DatasetFormat = 3"),
    Edit(_ENROLMENT, "from pydantic import Field", "from pydantic import AliasChoices, Field"),
    Edit(
        _ENROLMENT,
        '    salt: Annotated[str, Field(pattern="^[0-9a-f]{32}$")] | None = None\n',
        '    seed_salt: str | None = Field(None, validation_alias=AliasChoices("seed_salt", "salt"))\n',
    ),
    Edit(_ENROLMENT, "self.salt", "self.seed_salt"),
    Edit(_ENROLMENT, "settled.salt", "settled.seed_salt"),
    Edit("experiment/study/people/enrolling.py", "begun.salt", "begun.seed_salt"),
    Edit(_ENROLMENT, "(root).salt", "(root).seed_salt"),
    Edit(_ENROLMENT, '{"salt"', '{"seed_salt"'),
    Edit(_NAMES, "settled.get('salt')", "settled.get('seed_salt', settled.get('salt'))"),
    Edit(
        "experiment/records/events.json",
        ' "all": {\n',
        ' "all": {\n  "later": {\n   "Description": "A column that came later."\n  },\n',
    ),
    Edit(_PAGE, "FORMAT = 5", "FORMAT = 6"),
    Edit(_PAGE, '"made_by": {', '"room": None, "written_by": {'),
)


def plant(folder: Path) -> Path:
    """Return a copy of the checkout with the next number of every format. Raises `ValueError` for a stale edit."""
    copy = folder / "branch"
    ignored = shutil.ignore_patterns(*LEFT)
    for name in SOURCES:
        shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=ignored)
    (copy / "participants").mkdir()
    for name in EVERYWHERE:
        old, new = RENAMED[name]
        for path in (*(copy / "experiment").rglob("*.py"), *(copy / "tests" / "experiment").rglob("*.py")):
            text = path.read_text("utf-8")
            # Texts of protocols that tests change have the format that they had.
            found = re.sub(rf"\b{old}\b(?! = )" if "tests" in path.parts else rf"\b{old}\b", new, text)
            if found != text:
                path.write_text(found, "utf-8")
    for edit in EDITS:
        path = copy / edit.file
        text = path.read_text("utf-8")
        if edit.old not in text:
            raise ValueError(f"{edit.file} has no {edit.old!r}; write this edit anew for the source as it is")
        path.write_text(text.replace(edit.old, edit.new), "utf-8")
    return copy


def numbers(root: Path, out: Path) -> dict[str, Any]:
    """Return what is refused of a dataset before and after it is built, its trials and its results."""
    refused = [verify.verify(root).refused]
    build.build(root)
    refused.append(verify.verify(root).refused)
    results = dict(analyse([root], out, figures=False).numbers)
    trials = palpate.read(root).attempts.drop(columns="later", errors="ignore").to_csv()
    return {"refused": refused, "trials": trials, "results": results}


def make(folder: Path) -> MadeStudy:
    """Make a study in which one participant of two did their first task, and agreed to sharing."""
    study = make_study(folder, further=asking(SHARING, PEOPLE), sessions=1)
    enrolling.sharing(study.file, "01", True, root=study.root)
    return study


def go_on(folder: Path) -> None:
    """Run the other's first task in the study of a folder, who agrees to sharing too."""
    study = MadeStudy(folder / "study.toml", folder / "dataset")
    study.run(study.header("02", study.tasks[1].tasks[0]))
    enrolling.sharing(study.file, "02", True, root=study.root)


def rehearse(file: Path, rig: Path, out: Path) -> None:
    """Rehearse a protocol."""
    rehearsal.rehearse(protocol_file=file, rig_file=rig, out=out, participants=1, seed=1)


ACTS: dict[str, Callable[..., object]] = {one.__name__: one for one in (numbers, make, go_on, rehearse)}

if __name__ == "__main__":
    done = ACTS[sys.argv[1]](*map(Path, sys.argv[2:]))
    sys.stdout.write(json.dumps(done, default=str))
