"""The portable part of palpate, as on macOS."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.portable.commands import Masked
from tests.portable.conftest import Results, cases, check_end, check_help, check_texts
from tests.portable.matrix import Command

SYSTEM = "macos"


def test_every_module_can_be_imported(masked: Masked) -> None:
    assert (masked.platform, masked.failures) == ("darwin", {})


def test_every_command_has_its_help(masked: Masked, tmp_path: Path) -> None:
    check_help(masked, tmp_path)


@pytest.mark.parametrize("command", cases(SYSTEM))
def test_a_command_ends_as_it_should(results: Results, command: Command) -> None:
    check_end(results, command)


def test_texts_do_not_depend_on_the_system(results: Results) -> None:
    check_texts(results.folder)
