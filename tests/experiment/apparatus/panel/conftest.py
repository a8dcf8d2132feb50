"""A response table on disk."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.experiment.apparatus.panel.tables import Write


@pytest.fixture
def written(tmp_path: Path) -> Write:
    def write_text(text: str) -> Path:
        path = tmp_path / "response.csv"
        path.write_text(text, "utf-8")
        return path

    return write_text
