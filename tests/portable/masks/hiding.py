"""How a mask hides: palpate's modules have builtins of their own, and functions that all modules share ask who calls.

Python takes `__import__` from the builtins of the module that imports. A module of palpate is executed with builtins
that belong to the mask, so that what it imports is a view of a module, or nothing. These builtins also show whether a
frame is palpate's. So a function such as `os.replace`, which `Path.replace` calls for palpate, knows whom to refuse.
"""

from __future__ import annotations

import builtins
import errno
import importlib.util
import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial, wraps
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from itertools import pairwise
from types import MappingProxyType, ModuleType
from typing import Any

from tests.portable.masks.systems import System

Call = Callable[..., Any]

Make = Callable[[Call], Call]
"""Given a real function, returns what the other system has in its place."""

Prepare = Callable[["Mask", Any], Mapping[str, object]]
"""Called with a module when palpate first imports it; returns what its view has under some names."""

_TAKES_PATHS = ("io.open", "os.open", "os.stat", "os.lstat", "os.listdir", "os.scandir")


class View(ModuleType):
    """A module as another system has it: without what is hidden, and with what is different there."""

    def __init__(self, real: ModuleType, hidden: Callable[[str], bool], instead: Mapping[str, object]) -> None:
        super().__init__(real.__name__, real.__doc__)
        vars(self).update(instead, _view=(real, hidden))

    def __getattr__(self, name: str) -> Any:
        real, hidden = vars(self)["_view"]
        if hidden(name):
            raise AttributeError(f"module {real.__name__!r} has no attribute {name!r}", name=name, obj=self)
        return getattr(real, name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(vars(self)["_view"][0], name, value)

    def __delattr__(self, name: str) -> None:
        delattr(vars(self)["_view"][0], name)

    def __dir__(self) -> list[str]:
        real, hidden = vars(self)["_view"]
        return [name for name in dir(real) if not hidden(name)]


class Mask:
    """What palpate's modules see of a system, from `put_on` to the end of the process."""

    def __init__(
        self,
        system: System,
        functions: Mapping[str, Make],
        modules: Mapping[str, Prepare],
        settings: Mapping[str, object] = MappingProxyType({}),
    ) -> None:
        """Take the functions that differ, by module and name (`os.replace`), and the modules that differ, by name.

        `settings` are values, by module and name, that a module of the library found when it was imported.
        """
        self._system = system
        self._settings = settings
        self._functions = functions
        self._modules = {"importlib": _importlib, "importlib.util": _importlib_util} | dict(modules)
        self._viewed = {lack.module for lack in system.lacks} | set(self._modules)
        self._views: dict[str, View] = {}
        self._builtins = vars(builtins) | {"__import__": self._import}

    def put_on(self) -> None:
        """Show this system to what is imported of palpate from now on, and to a main module of palpate."""
        sys.meta_path.insert(0, _Finder(self._builtins))
        for place in sorted({*_TAKES_PATHS, *self._functions}):
            module, _, name = place.partition(".")
            self.substitute(import_module(module), name, self._make(place))
        for place, value in self._settings.items():
            module, _, name = place.partition(".")
            setattr(import_module(module), name, value)
        self._builtins["open"] = import_module("io").open
        if _main_is_palpates(sys.orig_argv):
            vars(sys.modules["__main__"])["__builtins__"] = self._builtins

    def substitute(self, owner: object, name: str, make: Make) -> None:
        """Have palpate, and the standard library on its behalf, call what is made; everybody else the real function."""
        real = getattr(owner, name)
        other = make(real)

        @wraps(real)
        def chosen(*arguments: Any, **options: Any) -> Any:
            return (other if self._palpate_calls() else real)(*arguments, **options)

        setattr(owner, name, chosen)

    def absent(self, module: str) -> bool:
        """Return whether a module cannot be imported there."""
        return module.partition(".")[0] in self._system.modules

    def view(self, module: ModuleType) -> ModuleType:
        """Return a module as palpate sees it."""
        name = module.__name__
        if name not in self._viewed:
            return module
        if name not in self._views:
            prepare = self._modules.get(name)
            instead = prepare(self, module) if prepare else {}
            self._views[name] = View(module, cache(partial(self._system.hides, name)), instead)
        return self._views[name]

    def _import(
        self,
        name: str,
        globals: Mapping[str, object] | None = None,  # noqa: A002
        locals: Mapping[str, object] | None = None,  # noqa: A002
        fromlist: Sequence[str] | None = (),
        level: int = 0,
    ) -> ModuleType:
        if level == 0 and self.absent(name):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return self.view(builtins.__import__(name, globals, locals, fromlist or (), level))

    def _palpate_calls(self) -> bool:
        """Return whether the function that `chosen` stands for is called by palpate, itself or through the library."""
        frame = sys._getframe(2)
        # It makes and removes files as the system lets it; its `onerror` and `onexc` go on with what was refused.
        if frame.f_globals.get("__name__") == "tempfile" and not frame.f_code.co_name.startswith("on"):
            return False
        while frame.f_builtins is not self._builtins:
            name = str(frame.f_globals.get("__name__"))
            if name.partition(".")[0] not in sys.stdlib_module_names or frame.f_back is None:
                return False
            frame = frame.f_back
        return True

    def _make(self, place: str) -> Make:
        """Return what makes a function of this system, to which the folders of Linux are not there."""
        different: Make = self._functions.get(place, lambda real: real)
        if place not in _TAKES_PATHS:
            return different

        def make(real: Call) -> Call:
            other = different(real)

            def without_folders(path: Any = ".", *arguments: Any, **options: Any) -> Any:
                if not isinstance(path, int) and self._system.lacks_file(os.fsdecode(path)):
                    raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), path)
                return other(path, *arguments, **options)

            return without_folders

        return make


def _importlib(mask: Mask, _real: Any) -> Mapping[str, object]:
    def by_name(name: str, package: str | None = None) -> ModuleType:
        if mask.absent(name):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return mask.view(import_module(name, package))

    return {"import_module": by_name, "util": mask.view(importlib.util)}


def _importlib_util(mask: Mask, real: Any) -> Mapping[str, object]:
    def find_spec(name: str, package: str | None = None) -> ModuleSpec | None:
        return None if mask.absent(name) else real.find_spec(name, package)

    return {"find_spec": find_spec}


def _main_is_palpates(command: Sequence[str]) -> bool:
    """Return whether Python was started with `-m` and a module of palpate, or with `-c` and code that imports one."""
    for flag, text in pairwise(command):
        if flag == "-m":
            return text.partition(".")[0] == "palpate"
        if flag == "-c":
            return re.search(r"\bpalpate\.", text) is not None
    return False


class _Loader(SourceFileLoader):
    def __init__(self, name: str, path: str, names: dict[str, Any]) -> None:
        super().__init__(name, path)
        self._names = names

    def exec_module(self, module: ModuleType) -> None:
        vars(module)["__builtins__"] = self._names
        super().exec_module(module)


class _Finder(MetaPathFinder):
    """Finds palpate's modules where Python finds them, and has them executed with other builtins."""

    def __init__(self, names: dict[str, Any]) -> None:
        self._names = names

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname.partition(".")[0] != "palpate":
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = _Loader(spec.loader.name, spec.loader.path, self._names)
        return spec
