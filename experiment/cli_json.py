"""What commands print for programs: one JSON document, and nothing else on standard output."""

from __future__ import annotations

import typer


def put(document: object) -> None:
    """Print a document."""
    import json

    typer.echo(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False))
