"""What every test of a session starts from."""

from __future__ import annotations

from pathlib import Path

import pytest

from palpate.experiment.protocol import files
from palpate.experiment.protocol.models import Protocol


@pytest.fixture(scope="module")
def protocol(repository_root: Path) -> Protocol:
    return files.load(repository_root / "protocols" / "okamoto2012.toml")
