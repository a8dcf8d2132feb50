"""The canonical form depends on what a file states, never on how."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from datetime import date
from pathlib import Path
from typing import Any, Literal, get_args

import pytest
from pydantic import Field, ValidationError, create_model

from palpate.experiment.errors import ProtocolError
from palpate.experiment.protocol import approval, files
from palpate.experiment.protocol.approval import canonical, sealing, sha256
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.models import Material, Protocol
from palpate.experiment.settings.load import Confined
from tests.experiment.protocol.small import SMALL, changed, document, leaves, protocol

NUMBERS = get_args(Protocol.model_fields["format"].annotation)
NEWEST, LATER = max(NUMBERS), max(NUMBERS) + 1
FORMATS: Any = Literal[(*NUMBERS, LATER)]


def loaded(tmp_path: Path, text: str) -> Protocol:
    file = tmp_path / "study.toml"
    file.write_text(text, encoding="utf-8")
    return files.load(file)


def plain(value: Any) -> Any:
    """What RFC 8785 makes of numbers: those without a fraction are written without one."""
    if isinstance(value, dict):
        return {key: plain(held) for key, held in value.items()}
    if isinstance(value, list):
        return [plain(held) for held in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value


def test_form_is_that_of_rfc_8785() -> None:
    # For ASCII keys and numbers of few digits, Python's own JSON with sorted keys is the same form.
    # In the newest format every key stands in it.
    study = protocol().model_copy(update={"format": NEWEST})
    document = plain(json.loads(study.model_dump_json()))
    expected = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    assert canonical(study) == expected.encode()
    assert sha256(study) == hashlib.sha256(expected.encode()).hexdigest()


def test_a_file_of_format_2_names_no_materials_of_a_test(tmp_path: Path, reference: Path) -> None:
    text = (reference / "protocols" / "okamoto2012-3.toml").read_text("utf-8")
    assert loaded(tmp_path, text).analysis[1].materials == ("aluminum foil", "typing paper")
    with pytest.raises(ProtocolError) as refused:
        loaded(tmp_path, text.replace("format = 3", "format = 2"))
    assert [problem.field for problem in refused.value.findings] == ["analysis[1].materials"]


class Amplifier(Confined):
    """A table that the next format would bring."""

    gain_db: float = 0.0


class LaterMaterial(Material):
    """A material with a key of the next format."""

    color: str | None = Field("white", json_schema_extra={"since": LATER})


LaterStudy = create_model(
    "LaterStudy",
    __base__=ProtocolFile,
    format=(FORMATS, ...),
    materials=(tuple[LaterMaterial, ...], ...),
    amplifier=(Amplifier, Field(Amplifier(), json_schema_extra={"since": LATER})),
)
"""A protocol as the next format would have it: keys with defaults at the top, and inside the tables of an array."""


def test_a_key_that_is_added_with_a_default_changes_no_form_of_an_older_format() -> None:
    older, newer = (LaterStudy.model_validate({**document(), "format": number}) for number in (4, LATER))
    assert canonical(older) == canonical(protocol())
    form = json.loads(canonical(newer))
    assert (form["amplifier"], form["materials"][0]["color"]) == ({"gain_db": 0}, "white")


def test_a_seal_holds_on_when_a_later_palpate_has_more_keys(tmp_path: Path) -> None:
    file = tmp_path / "study.toml"
    file.write_text(SMALL, "utf-8")
    sealed = sealing.write(
        file,
        files.load(file),
        approval_number="2020-17",
        board="Board of tests",
        approved_on=date(2020, 2, 1),
        expires_on=date(2021, 2, 1),
    )
    later = LaterStudy.model_validate(document())
    assert approval.verify(file, later, date(2020, 6, 1)) == sealed
    louder = later.model_copy(update={"amplifier": Amplifier(gain_db=6.0), "format": LATER})
    with pytest.raises(ProtocolError, match="amplifier"):
        approval.verify(file, louder, date(2020, 6, 1))


def test_a_younger_key_is_refused_in_a_file_of_an_older_format(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "ProtocolFile", LaterStudy)
    text = SMALL + "\n[amplifier]\ngain_db = 6.0\n"
    with pytest.raises(ProtocolError) as refused:
        loaded(tmp_path, text)
    (problem,) = refused.value.findings
    assert (problem.field, problem.line) == ("amplifier", SMALL.count("\n") + 2)
    assert loaded(tmp_path, text.replace("format = 4", f"format = {LATER}")).model_dump()["format"] == LATER
    assert loaded(tmp_path, SMALL).format == 4


def test_every_value_of_the_file_stands_in_the_form() -> None:
    form = json.loads(canonical(protocol()))
    for path, value in leaves(document()):
        found = form
        for part in path:
            found = found[part]
        assert found == (value.isoformat() if isinstance(value, date) else value), path


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("\n[masker]", "\n# a comment\n\n[masker]   # another"),
        ("gate_top_mm = 18", "gate_top_mm = 1.8e1"),
        ("samples = 1000", "samples = 0x3e8"),
        ('title = "The first"', "'title' = '''The first'''"),
        ('order = { kind = "max-run", max_run = 2 }', "order.max_run = 2\norder.kind = 'max-run'"),
        ('noise = "pink"\nlevel_set_by = "participant"', 'level_set_by = "participant"\nnoise = "pink"'),
        ("alpha = 0.01", "alpha = 0.01\n[ethics.more]\n".partition("\n")[0]),
        ('reason = "they left"', 'reason = "they\\u0020left"'),
    ],
)
def test_the_way_of_writing_does_not_matter(tmp_path: Path, old: str, new: str) -> None:
    assert SMALL.count(old) == 1
    assert sha256(loaded(tmp_path, SMALL.replace(old, new))) == sha256(protocol())


def test_the_order_of_tables_does_not_matter(tmp_path: Path) -> None:
    head, *tables = re.split(
        r"(?m)^(?=\[(?:ethics|duration|exposure|masker|answers|synthesis|step|task_order)\]$)", SMALL
    )
    last = tables.pop()
    moved = head + "".join(reversed(tables)) + last
    assert moved != SMALL
    assert tomllib.loads(moved) == tomllib.loads(SMALL)
    assert sha256(loaded(tmp_path, moved)) == sha256(protocol())


def test_a_default_that_is_written_down_changes_nothing(tmp_path: Path) -> None:
    stated = SMALL.replace('question = "Better than chance?"', 'question = "Better than chance?"\nalpha = 0.05')
    assert sha256(loaded(tmp_path, stated)) == sha256(protocol())


def test_any_other_value_changes_the_hash() -> None:
    hashes = {sha256(protocol())}
    tried = 0
    for path, value in leaves(document()):
        other = {str: f"{value}x", date: date(2020, 5, 5), bool: not value}.get(type(value), value)
        other = value + 1 if other == value else other
        try:
            hashes.add(sha256(ProtocolFile.model_validate(changed(document(), path, other))))
            tried += 1
        except ValidationError:
            continue
    assert tried > 50
    assert len(hashes) == tried + 1
