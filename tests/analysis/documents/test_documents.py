"""What a section is written to depends on what it has."""

from __future__ import annotations

import pytest
from matplotlib.figure import Figure

from analysis.documents import page
from analysis.documents.drawing import Sheet
from analysis.documents.tables import Section, Table

TABLE = Table("A table", ("a", "b"), (("x", "1"),))
RECORDS = ({"a": "x", "b": 1},)


@pytest.mark.parametrize(
    ("section", "kinds"),
    [
        (Section("part", "Part", ("Said.",), (TABLE,), RECORDS), ["csv", "md", "tex"]),
        (Section("part", "Part", ("Said.",)), ["md"]),
        (Section("part", "Part", records=RECORDS), ["csv"]),
        (Section("part", "Part"), []),
    ],
)
def test_files_of_a_section(section: Section, kinds: list[str]) -> None:
    files = page.tables([section], "SIMULATED", "tables/")
    assert list(files) == [f"tables/part.{kind}" for kind in kinds]
    assert all(b"SIMULATED" in content for content in files.values())


def test_files_of_a_figure() -> None:
    """The signatures of PNG (RFC 2083, 3.1) and of an XML document."""
    one = Sheet("map", "confusions", "What it shows.", Figure())
    files = page.drawings([one], "figures/")
    assert list(files) == ["figures/map.svg", "figures/map.png"]
    assert files["figures/map.png"].startswith(b"\x89PNG\r\n\x1a\n")
    assert files["figures/map.svg"].startswith(b"<?xml")
    found = page.captions([one], [("Name", "formula")])
    assert (found.places, found.captions) == ({"map": "confusions"}, {"map": "What it shows."})
