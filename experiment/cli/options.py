"""What commands print for programs: one JSON document, and nothing else on standard output.

The progress bar of long commands.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import typer


def put(document: object) -> None:
    """Print a document."""
    import json

    typer.echo(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False))


@contextmanager
def progress(label: str, *, quiet: bool) -> Iterator[tuple[Callable[[int], None], Callable[[], None]]]:
    """A progress bar on standard error: what sets its total, and what moves it on.

    It is not drawn before its total is set: what is refused until then leaves one line.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    bar = Progress(*columns, console=Console(stderr=True), disable=quiet)
    task = bar.add_task(label, total=None)

    def begin(total: int) -> None:
        bar.update(task, total=total)
        bar.start()

    try:
        yield begin, lambda: bar.advance(task)
    finally:
        if bar.live.is_started:
            bar.stop()
