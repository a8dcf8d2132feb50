"""What a section is written to depends on what it has."""

from __future__ import annotations

import json
import os
import signal
from multiprocessing.connection import Connection

import pytest
from matplotlib.figure import Figure

from palpate import __version__
from palpate.analysis.documents import page
from palpate.analysis.documents.drawing import Sheet
from palpate.analysis.documents.tables import Asked, Section, Table
from palpate.experiment.records import software

TABLE = Table("A table", ("a", "b"), (("x", "1"),))
RECORDS = ({"a": "x", "b": 1},)


@pytest.mark.parametrize(
    ("section", "kinds"),
    [
        (Section("part", "Part", ("Said.",), (TABLE,), RECORDS), ["csv", "md", "tex"]),
        (Section("part", "Part", ("Said.",)), ["md"]),
        (Section("part", "Part", further=RECORDS), ["csv"]),
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


class Refused(Exception):
    """What a figure that cannot be drawn raises."""


class Undrawn(Figure):
    def savefig(self, *_: object, **__: object) -> None:
        raise Refused


def _numbered() -> list[Sheet]:
    """Three figures, no two of which are alike."""
    return [Sheet(f"figure{n}", "confusions", "", Figure(figsize=(n, 1))) for n in (1, 2, 3)]


def test_figures_are_the_same_whichever_process_draws_them(monkeypatch: pytest.MonkeyPatch) -> None:
    alone = [page.drawings([one]) for one in _numbered()]
    expected = alone[0] | alone[1] | alone[2]
    assert len(set(expected.values())) == 6
    assert list(page.drawings(_numbered()).items()) == list(expected.items())

    def refused() -> int:
        raise BlockingIOError

    monkeypatch.setattr("os.fork", refused)
    assert page.drawings(_numbered()) == expected


@pytest.mark.parametrize("before", [b"", b"\x00\x00\x10\x00 the first of 4,096 bytes"])
def test_figures_of_a_process_that_is_killed_are_drawn_by_the_other(
    monkeypatch: pytest.MonkeyPatch, before: bytes
) -> None:
    """Killed before it sends anything, and after the length of what it sends (multiprocessing: 4 bytes) and a piece."""
    expected = page.drawings(_numbered())

    def killed(sending: Connection, _: object) -> None:
        os.write(sending.fileno(), before)
        os.kill(os.getpid(), signal.SIGKILL)

    monkeypatch.setattr(Connection, "send", killed)
    assert page.drawings(_numbered()) == expected


@pytest.mark.usefixtures("no_process_stays")
def test_an_interrupt_ends_the_process_that_draws_too(monkeypatch: pytest.MonkeyPatch) -> None:
    here = os.getpid()

    def drawing(*_: object, **__: object) -> None:
        if os.getpid() == here:
            raise KeyboardInterrupt
        signal.pause()

    monkeypatch.setattr(Figure, "savefig", drawing)
    with pytest.raises(KeyboardInterrupt):
        page.drawings(_numbered())


@pytest.mark.parametrize("place", [0, 1])
def test_what_a_figure_raises_is_raised_here(place: int) -> None:
    figures = _numbered()
    figures[place] = Sheet("undrawn", "confusions", "", Undrawn())
    with pytest.raises(Refused):
        page.drawings(figures)


def test_a_figure_stands_in_its_section_with_its_caption_and_the_formulas_on_the_page_of_methods() -> None:
    one = Sheet("map", "confusions", "What it shows.", Figure())
    parts = [Section("overview", "Study"), Section("confusions", "Confusions")]
    made = page.folder("A study", "SIMULATED", parts, [one], [("Name", "formula")], {"n": 1})
    report = made[page.REPORT].decode()
    before, section = report.split('<details class="part" id="confusions">')
    assert "<figcaption>" not in before
    assert section.count("<figcaption>Figure 1. SIMULATED. What it shows.</figcaption>") == 1
    assert "<dt>Name</dt><dd>formula</dd>" in made[page.METHODS].decode()
    assert "formula" not in report
    results = json.loads(made["results.json"])
    assert (results["format"], results["n"]) == (page.FORMAT, 1)
    assert results["made_by"] == {"palpate": __version__, "source_sha256": software.this().source_sha256}


def test_questions_are_on_the_first_screen_with_their_answers_and_warnings() -> None:
    asked = Asked("Do <they> differ?", "They do.", "planned", ("It errs.",))
    made = page.folder(
        "A study", "", [Section("answers", "Answers", asked=(asked,)), Section("more", "More")], [], [], {}
    )
    first, folded = made[page.REPORT].decode().split('<details class="part"')
    places = [first.index(text) for text in ("Do &lt;they&gt; differ?", "planned", "They do.", ">It errs.<")]
    assert places == sorted(places)
    assert "More" in folded


def test_sections_of_methods_are_on_their_own_page() -> None:
    further = Section("icc", "Intraclass correlations", part=page.ON_METHODS)
    made = page.folder("A study", "", [Section("answers", "Answers"), further], [], [], {})
    assert 'id="icc"' in made[page.METHODS].decode()
    assert 'id="icc"' not in made[page.REPORT].decode()


def test_sections_after_the_first_are_folded_and_long_tables_once_more() -> None:
    folded = Section(
        "left", "Left out", ("Some.",), (TABLE,), brief=(Table("By rule", ("a",), (("y",),)),), folded=True
    )
    made = page.folder("A study", "", [Section("found", "What was found"), folded], [], [], {})
    report = made[page.REPORT].decode()
    assert report.index("What was found</h2>") < report.index('<details class="part"')
    counted, details = report.split("<details>")
    assert "By rule" in counted
    assert "A table" not in counted
    assert details.index("A table") < details.index("</details>")
