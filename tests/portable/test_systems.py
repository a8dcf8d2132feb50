"""What the masks hide, compared with what typeshed's stubs say that each system has."""

from __future__ import annotations

import ast
import importlib
import sys
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import mypy
import pytest

from tests.portable.masks.systems import SYSTEMS, System

STUBS = Path(mypy.__file__).parent / "typeshed" / "stdlib"


@cache
def stub(module: str) -> ast.Module:
    """The stub of a module."""
    folder = STUBS / module
    return ast.parse((folder / "__init__.pyi" if folder.is_dir() else folder.with_suffix(".pyi")).read_text("utf-8"))


def names(module: str, platform: str) -> set[str]:
    """The public names that a stub gives a module on a platform, for the version of Python that runs."""
    there = {"sys": SimpleNamespace(platform=platform, version_info=sys.version_info)}
    found: set[str] = set()
    ahead: list[ast.stmt] = list(stub(module).body)
    while ahead:
        match ahead.pop():
            case ast.If(test=test, body=body, orelse=orelse):
                ahead += body if eval(ast.unparse(test), there) else orelse
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                found.add(name)
            case ast.AnnAssign(target=ast.Name(id=name)) | ast.Assign(targets=[ast.Name(id=name)]):
                found.add(name)
            case ast.ImportFrom(module=str(other), names=[ast.alias(name="*")]):
                found |= names(other, platform)
            case ast.ImportFrom(names=aliases):
                # Others are the stub's own.
                found |= {alias.name for alias in aliases if alias.asname == alias.name}
    return {name for name in found if not name.startswith("_")}


@pytest.mark.parametrize(
    ("system", "module"),
    [
        pytest.param(system, module, id=f"{system.name}-{module}")
        for system in SYSTEMS.values()
        for module in sorted({lack.module for lack in system.lacks})
    ],
)
def test_a_module_lacks_what_its_stub_says(system: System, module: str) -> None:
    here = {name for name in vars(importlib.import_module(module)) if not name.startswith("_")}
    lacking = names(module, "linux") - names(module, system.platform)
    assert {name for name in here if system.hides(module, name)} == lacking & here


def test_modules_without_a_name_on_windows_cannot_be_imported_there() -> None:
    conditional = [path.stem for path in STUBS.glob("*.pyi") if "sys.platform" in path.read_text("utf-8")]
    empty = {module for module in conditional if names(module, "linux") and not names(module, "win32")}
    assert {"fcntl", "termios", "pty"} <= empty <= SYSTEMS["windows"].modules
