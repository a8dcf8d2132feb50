"""Values as others print them, from `tests/reference`."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent.parent / "reference"


def printed(table: str) -> dict[str, Any]:
    """One table of `statistics.toml`; its `source` says where the values stand."""
    found: dict[str, Any] = tomllib.loads((FOLDER / "statistics.toml").read_text(encoding="utf-8"))[table]
    assert found["source"]
    return found
