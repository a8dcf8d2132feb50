"""Ratings in a protocol: what is refused, and what is answered and shown."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import tomlkit
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.errors import ProtocolError
from palpate.experiment.protocol import files, page
from palpate.experiment.protocol.designs import design_of
from tests.experiment.protocol import leveled
from tests.experiment.protocol import rating as rated
from tests.experiment.protocol.small import changed, with_tuples

TABLES = with_tuples(rated.study())


def refused(tables: dict[str, Any], folder: Path) -> set[str]:
    file = folder / "study.toml"
    file.write_text(tomlkit.dumps(tables), "utf-8")
    with pytest.raises(ProtocolError) as error:
        files.load(file)
    return {finding.field for finding in error.value.findings}


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        (("rating", "scale", 2, "value"), 2, "rating.scale[2].value"),
        (("rating", "scale", 2, "key"), "5", "rating.scale[4].key"),
        (("rating", "scale", 2, "key"), "n", "answers.no_answer_key"),
        (("rating", "standard"), "glass", "rating.standard"),
        (("rating", "modulus"), 9, "rating.modulus"),
        (("rating", "magnitudes"), (), "analysis[2].test"),
        (("rating", "magnitudes", 1, "material"), "copy paper", "rating.magnitudes"),
        (("rating", "scale", 0, "value"), 0, "analysis[2].test"),
        (("materials", 0, "key"), "x", "materials[0].key"),
        (("analysis", 0, "test"), "equivalence", "analysis[0].test"),
        (("tasks", 0, "levels"), leveled.STEPS, "tasks[0].levels"),
        (("format",), 6, "analysis[0].test"),
    ],
)
def test_what_a_rating_cannot_be_is_refused_by_its_field(
    path: tuple[str | int, ...], value: object, field: str, tmp_path: Path
) -> None:
    assert field in refused(changed(TABLES, path, value), tmp_path)


def test_a_design_without_its_table_is_refused(tmp_path: Path) -> None:
    assert "rating" in refused({key: one for key, one in TABLES.items() if key != "rating"}, tmp_path)


def test_answers_are_numbers_on_record_and_in_words_for_the_experimenter() -> None:
    protocol, design = rated.protocol(), design_of("rating")
    answers = design.answers(protocol, ())
    assert {key: one.answer for key, one in answers.items()} == {str(n): str(n) for n in range(1, 6)}
    words = tuple(one.words for one in answers.values())
    assert words == design.shown(protocol) == tuple(design.named(protocol).values())
    assert design.right is None


def test_the_board_reads_scale_standard_and_magnitudes(approved: SnapshotAssertion) -> None:
    text = page.page(rated.protocol(), "rated.toml")
    sections = text.partition("6. Materials")[2].partition("7. Stimuli")[0], text.partition("9. Answers")[2]
    assert "\n".join((sections[0], sections[1].partition("12. Left")[0])) == approved
