"""The one command, `palpate`; imports each part on use, so that --help stays light."""

from __future__ import annotations

import typer

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False, no_args_is_help=True)


@app.callback()
def palpate() -> None:
    """Run vibrotactile psychophysics: from an ethics-reviewed protocol to published tables."""


def main() -> None:
    """Entry point of the command."""
    app()
