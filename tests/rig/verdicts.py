"""What `palpate doctor` says, read back."""

from __future__ import annotations

import json

LOAD = {"tracker arrival", "audio stream", "audio timeline", "disk writing", "machine load"}
"""What measures how loaded the machine is, which these tests do not set; tests/experiment/checks judges them."""


def red(found: dict[str, dict[str, str]]) -> set[str]:
    """What is red, load apart."""
    return {name for name, check in found.items() if check["verdict"] == "red"} - LOAD


def verdicts(out: str) -> dict[str, dict[str, str]]:
    return {check["name"]: check for check in json.loads(out)["checks"]}
