"""The canonical form depends on what a file states, never on how."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from palpate.experiment.protocol import files
from palpate.experiment.protocol.approval import canonical, names_draws, sha256
from palpate.experiment.protocol.models import Protocol
from tests.experiment.protocol.small import SMALL, changed, document, leaves, protocol


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
    for study, left_out in ((protocol(), YOUNGER), (stated(), ())):
        document = json.loads(study.model_dump_json())
        assert document.pop("comparison") is None
        # Younger keys of footsteps' materials and limits, which these do not have.
        assert document["exposure"].pop("force_peak_n") is None
        assert {one.pop(key) for one in document["materials"] for key in ("attack_hz", "amplitude")} == {None}
        for *tables, key in left_out:
            table = document
            for name in tables:
                table = table[name]
            del table[key]
        for listed, younger in (("analysis", ("correction", "margin")), ("tasks", ("masker", "materials"))):
            document[listed] = [
                {key: held for key, held in one.items() if key not in younger or held} for one in document[listed]
            ]
        expected = json.dumps(plain(document), sort_keys=True, separators=(",", ":"), ensure_ascii=False)
        assert canonical(study) == expected.encode()
        assert sha256(study) == hashlib.sha256(expected.encode()).hexdigest()


YOUNGER = (
    ("consent", "kept_months"),
    ("answers", "on_screen"),
    ("answers", "microphone"),
    ("masker", "probe"),
    ("footstep", "synthesis", "left_out_max"),
)
"""Keys that are younger than format 2, and are left out where they are not stated."""


def stated() -> Protocol:
    """With all of them."""
    tables = document()
    probe = {"material": tables["materials"][0]["id"], "speed_mm_s": 200.0}
    for where, value in zip(YOUNGER, (18, True, True, probe, 0.25), strict=True):
        tables = changed(tables, where, value)
    same = {"test": "equivalence", "tasks": (tables["tasks"][0]["id"],), "question": "?", "margin": 0.1}
    tables["analysis"] = (*tables["analysis"], same)
    return Protocol.model_validate(changed(tables, ("analysis", 0, "correction"), "materials"))


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
            hashes.add(sha256(Protocol.model_validate(changed(document(), path, other))))
            tried += 1
        except ValidationError:
            continue
    assert tried > 50
    assert len(hashes) == tried + 1


def test_a_study_moved_to_format_2_keeps_the_name_of_its_draws(repository_root: Path) -> None:
    # What palpate 0.1 gave as canonical hash of the same study in format 1, and named its draws by.
    study = files.load(repository_root / "protocols" / "okamoto2012.toml")
    assert names_draws(study) == "c2bbbf35cb953c97f328aa6819b0fcaa408e5e6420023a34fb35377f3605ed1a"
    assert names_draws(study) != sha256(study)


def test_a_seal_that_was_given_before_a_key_was_there_holds_on(repository_root: Path) -> None:
    # What palpate gave as hash of the published study before these were keys, on its board's page.
    study = files.load(repository_root / "protocols" / "okamoto2012.toml")
    assert sha256(study) == "8b60d1b6a50b0cf7d7030d0d4e7e2c25ad5501d369432e7fd73225a590d0f9a5"
    stated = study.model_copy(update={"consent": study.consent.model_copy(update={"kept_months": 120})})
    assert sha256(stated) != sha256(study)
    footstep = study.footsteps.model_copy(
        update={"synthesis": study.footsteps.synthesis.model_copy(update={"left_out_max": 0.5})}
    )
    assert sha256(study.model_copy(update={"footstep": footstep})) != sha256(study)
    quiet = study.tasks[0].model_copy(update={"masker": "none"})
    assert sha256(study.model_copy(update={"tasks": (quiet, *study.tasks[1:])})) != sha256(study)
    fewer = study.tasks[0].model_copy(update={"materials": ("copy paper",)})
    assert sha256(study.model_copy(update={"tasks": (fewer, *study.tasks[1:])})) != sha256(study)
