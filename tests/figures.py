"""How large the house is, how its modules hang together, and what is to become less: run `python -m tests.figures`.

Each figure has a limit, which was set once, at what was found then. It may be lowered, and is not raised by the change
that breaks it: something leaves, or the change waits. `measures/imports.py` says what trunks and wings are, and each of
`definitions.py` with `parameters.py`, `patterns.py` and `kinds.py` what it counts.
"""

from __future__ import annotations

import gc
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import grimp

from tests.measures import imports, kinds, parameters, patterns
from tests.measures.source import FOLDERS, PACKAGE, REPOSITORY, Source, entries, read_sources, tracked_files

TRUNKS: Mapping[str, int] = {"session": 21_500, "analysis": 15_500}
"""The most lines of each trunk. With those of a wing they take the place of limits on all lines, modules and imports of
the source: what a session or an analysis cannot do without is to stay small, and what can be taken away may come. They
had 19,344 and 13,912 lines when this second and last step was taken."""

WING = 4_500
"""The most lines of a wing."""

PAGES = "palpate/guide"
"""The site's own pages."""

SHOWN = 8
"""So many places say where a figure is too large; the rest are one `python -m tests.figures NAME` away."""


@dataclass(frozen=True)
class Figure:
    """One figure of the house, and the most that it may be."""

    name: str
    found: int
    most: int
    where: tuple[str, ...] = ()
    """What makes it as large as it is, if that can be named."""

    @property
    def line(self) -> str:
        shown = f"{self.name:<46} {self.found:>7,} of at most {self.most:,}"
        if self.found <= self.most or not self.where:
            return shown
        return f"{shown}: {'; '.join((*self.where[:SHOWN], *(('...',) if len(self.where) > SHOWN else ())))}"


def figures(sources: tuple[Source, ...]) -> tuple[Figure, ...]:
    """Return every figure: of the source, of the tests that git tracks, and of the imports between modules."""
    # A third of the time would go to looking for circles in syntax trees, which have none.
    gc.disable()
    try:
        return _all_figures(sources)
    finally:
        gc.enable()


def _all_figures(sources: tuple[Source, ...]) -> tuple[Figure, ...]:
    return (
        *_room_figures(),
        *_page_figures(),
        *_import_figures(sources),
        _count("functions of grade D or worse", sources, patterns.complex_functions, 10),
        _figure("parameters never varied", (each.place for each in parameters.unvaried_parameters(sources)), 27),
        _count("texts multiplied by a condition", sources, patterns.multiplied_texts, 0),
        _count("decisions by kind outside the kinds' rooms", sources, kinds.decisions, 0),
        *_test_figures(read_sources(tracked_files("tests"))),
    )


def _room_figures() -> Iterator[Figure]:
    rooms = entries(tracked_files(*FOLDERS))
    largest = sorted(rooms, key=lambda room: rooms[room], reverse=True)
    inner = [room for room in largest if room not in FOLDERS]
    yield from (Figure(f"entries of {folder}/", rooms[folder], 17) for folder in FOLDERS)
    yield Figure("entries of the largest room", rooms[inner[0]], 12, tuple(f"{r}: {rooms[r]}" for r in inner[:5]))


def _page_figures() -> Iterator[Figure]:
    words = {True: 0, False: 0}
    for path in tracked_files():
        if path.suffix == ".md":
            words[path.is_relative_to(PAGES)] += len((REPOSITORY / path).read_text("utf-8").split())
    yield Figure("words of Markdown beside the site's own pages", words[False], 30_100)
    yield Figure("words of the site's own pages", words[True], 12_000)


def _import_figures(sources: Iterable[Source]) -> Iterator[Figure]:
    graph = grimp.build_graph(PACKAGE, cache_dir=None)
    pairs = {(one, other) for one in graph.modules for other in graph.find_modules_directly_imported_by(one)}
    with (REPOSITORY / "pyproject.toml").open("rb") as file:
        contracts = tomllib.load(file)["tool"]["importlinter"]["contracts"]
    yield _figure("circles of imports", imports.circles(pairs), 0)
    yield _figure("arrows upward", imports.upward_imports(pairs, contracts), 0)
    lines = {source.module: source.lines for source in sources}
    for name, trunk in imports.TRUNKS.items():
        modules = imports.trunk_modules(trunk, pairs)
        yield Figure(f"lines of the {name} trunk", sum(lines.get(one, 0) for one in modules), TRUNKS[name])
    for name, rooms in imports.WINGS.items():
        yield Figure(f"lines of the wing {name}", imports.wing_lines(rooms, sources), WING)


def _test_figures(tests: Iterable[Source]) -> Iterator[Figure]:
    yield _count("assertions with words of a sentence", tests, patterns.sentence_assertions, 138)
    yield _count("match= with words of a sentence", tests, patterns.sentence_matches, 77)


def _count(name: str, sources: Iterable[Source], count: Callable[[Source], Iterator[str]], most: int) -> Figure:
    return _figure(name, (place for source in sources for place in count(source)), most)


def _figure(name: str, places: Iterable[str], most: int) -> Figure:
    where = tuple(sorted(places))
    return Figure(name, len(where), most, where)


if __name__ == "__main__":
    found = figures(read_sources(tracked_files(*FOLDERS)))
    # With words of a figure's name: each place that it counts.
    if words := " ".join(sys.argv[1:]):
        print("\n".join(place for figure in found if words in figure.name for place in figure.where))
    else:
        print("\n".join(figure.line for figure in found))
    sys.exit(any(figure.found > figure.most for figure in found))
