"""What every test of a session starts from."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiment.protocol.models import Protocol
from experiment.settings import load


@pytest.fixture(scope="module")
def protocol(repository_root: Path) -> Protocol:
    return load.load(repository_root / "protocols" / "okamoto2012.toml")
