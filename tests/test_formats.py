"""No format changes without its number."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from palpate.analysis.documents import page
from palpate.experiment.protocol.models import Material
from tests import formats, releases

HINT = "run python -m tests.formats, which says what changed, and what needs its next number"


@pytest.fixture(scope="module")
def today() -> dict[str, formats.Description]:
    return formats.descriptions()


def test_every_format_is_the_one_that_was_described_under_its_number(today: dict[str, formats.Description]) -> None:
    described = {name: formats.FOLDER / f"{name}.json" for name in today}
    assert [name for name, path in described.items() if not path.exists()] == [], HINT
    changed = [name for name, path in described.items() if path.read_text("utf-8") != formats.text(today[name])]
    assert changed == [], HINT


def test_the_schema_of_results_is_that_of_their_description() -> None:
    described = json.loads((formats.FOLDER / f"results-{page.FORMAT}.json").read_text("utf-8"))
    assert formats.RESULTS.read_text("utf-8") == formats.text(formats.results_schema(described)), HINT


@pytest.mark.parametrize(
    ("value", "fits"),
    [
        ({"n": 3, "people": {"07": 1.5}, "rows": [{"p": None, "q": 1}]}, True),
        ({"n": None, "people": {}, "rows": [], "more": 1}, True),
        ({"n": 3, "people": {"07": 1.5}}, False),
        ({"n": "3", "people": {}, "rows": []}, False),
        ({"n": 3, "people": {"07": "x"}, "rows": []}, False),
        ({"n": 3, "people": {}, "rows": [{"q": 1}]}, False),
    ],
    ids=["all", "nothing", "missing", "text", "person", "row"],
)
def test_results_fit_their_schema_or_not(monkeypatch: pytest.MonkeyPatch, value: object, fits: bool) -> None:
    monkeypatch.setattr(formats, "BY_DATA", {"people"})
    shape = {"n": "number", "people": {"01": "number"}, "rows": [{"p": "nothing", "q": "number"}, {"p": "number"}]}
    schema = formats.results_schema({"one": {"results.json": shape}, "export": {}})
    assert Draft202012Validator(schema).is_valid(value) is fits


def test_a_key_that_is_added_changes_the_description() -> None:
    class Later(Material):
        color: str | None = None

    one, other = (json.dumps(formats.schema(model)) for model in (Material, Later))
    assert '"color"' not in one
    assert '"color"' in other


def test_another_text_of_a_docstring_changes_none() -> None:
    class Reworded(Material):
        """Other words."""

    assert formats.schema(Reworded) == formats.schema(Material)


def test_a_description_under_a_new_number_is_changed_and_how_is_said(tmp_path: Path) -> None:
    had = {"columns": {"one": ["a"]}, "keys": {"two": 1, "three": [2]}}
    now = {"columns": {"one": ["a"], "other": ["b"]}, "keys": {"three": [2, 3]}}
    assert formats.write({"journal-99": had}, tmp_path) == (["+ journal-99"], [])
    assert formats.write({"journal-99": had}, tmp_path) == ([], [])
    changed = ["+ journal-99.columns.other", "~ journal-99.keys.three", "- journal-99.keys.two"]
    assert formats.write({"journal-99": now}, tmp_path) == (changed, [])
    assert json.loads((tmp_path / "journal-99.json").read_text("utf-8")) == now


@pytest.mark.parametrize(
    ("now", "taken"),
    [
        ({"columns": {"one": 1, "two": 2}}, True),
        ({"columns": {"one": 2}}, False),
        ({"columns": {"one": 1, "two": 2}, "keys": 1}, False),
    ],
)
def test_a_released_description_gets_a_new_kinds_columns_and_nothing_else(
    tmp_path: Path, now: dict[str, object], taken: bool
) -> None:
    (name,) = (one for one in releases.formats() if one.startswith("dataset-"))
    had = {"columns": {"one": 1}}
    file = tmp_path / f"{name}.json"
    file.write_text(formats.text(had), "utf-8")
    assert formats.write({name: now}, tmp_path)[1] == ([] if taken else [name])
    assert json.loads(file.read_text("utf-8")) == (now if taken else had)


def test_every_format_of_a_release_is_described() -> None:
    assert [name for name in releases.formats() if not (formats.FOLDER / f"{name}.json").exists()] == []
