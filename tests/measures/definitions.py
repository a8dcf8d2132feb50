"""The functions of the source, and what each name or attribute in a file can mean among them.

It goes by the syntax alone. What `room.name` or an imported name means is looked up along the imports; an attribute of
anything else can mean every method of that name.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from tests.measures.source import Source

FunctionNode = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass
class Function:
    """A function or a method, and what the source does with it."""

    source: Source
    name: str
    """With the class, or the function and `<locals>`, that it is in: `Tap.waveform`."""
    node: FunctionNode
    owner: str
    """The class that it is a method of, or nothing."""
    calls: list[tuple[Source, ast.Call]] = field(default_factory=list)
    is_passed_on: bool = False
    """Whether it is used as a value, so that not every call of it is known."""

    @property
    def is_bound(self) -> bool:
        """Whether a call does not give the first parameter."""
        return bool(self.owner) and "staticmethod" not in self.decorators

    @property
    def decorators(self) -> list[str]:
        """The last name of each decorator."""
        named = (each.func if isinstance(each, ast.Call) else each for each in self.node.decorator_list)
        return [(dotted_name(each) or "?").rpartition(".")[2] for each in named]


def dotted_name(node: ast.expr) -> str | None:
    """Return `a.b.c` of such an expression; None of any other."""
    match node:
        case ast.Name(id=name):
            return name
        case ast.Attribute(value=value, attr=attribute) if (before := dotted_name(value)) is not None:
            return f"{before}.{attribute}"
    return None


Key = tuple[str, str]
"""A module, and the name of a function or class in it, with what that is in."""


class Definitions:
    """Every function and class of some files, by module and name."""

    def __init__(self, sources: Iterable[Source]) -> None:
        self.functions: dict[Key, Function] = {}
        self._modules: set[str] = set()
        self._classes: dict[Key, ast.ClassDef] = {}
        self._methods: dict[str, list[Function]] = defaultdict(list)
        self.fields: set[str] = set()
        """Names of attributes that hold a value in one class or another."""
        self._imported: dict[str, dict[str, set[str]]] = {}
        for source in sources:
            self._modules.add(source.module)
            self._imported[source.module] = _import_paths(source)
            self._define(source, source.tree, "", "")
            self.fields |= set(_field_names(source))
        self._ancestors = {key: tuple(self._base_classes(key)) for key in self._classes}
        self._ports = [self._own_methods(key) for key in self._classes if self._is_port(key)]

    def _define(self, source: Source, parent: ast.AST, prefix: str, owner: str) -> None:
        for node in ast.iter_child_nodes(parent):
            if isinstance(node, FunctionNode):
                function = Function(source, prefix + node.name, node, owner)
                self.functions[source.module, function.name] = function
                if owner:
                    self._methods[node.name].append(function)
                self._define(source, node, f"{function.name}.<locals>.", "")
            elif isinstance(node, ast.ClassDef):
                self._classes[source.module, prefix + node.name] = node
                self._define(source, node, f"{prefix}{node.name}.", prefix + node.name)
            elif not isinstance(node, ast.expr):
                self._define(source, node, prefix, owner)

    def candidates(self, module: str, node: ast.expr, scopes: Iterable[str]) -> list[Function]:
        """Return the functions that an expression in a module may mean; a class means its `__init__`.

        `scopes` are the prefixes of the functions and classes that it is in, from the innermost one to the module's,
        which is empty.
        """
        path = dotted_name(node)
        if path is not None:
            head, _, rest = path.partition(".")
            places = [(module, scope + path) for scope in scopes]
            outside = self._imported[module].get(head, ())
            places += [self._split(f"{each}.{rest}" if rest else each) for each in outside]
            known = [place for place in places if place[0] not in self._modules or self._is_defined(place)]
            if known:
                return [function for place in known if (function := self._function(place)) is not None]
        return self.methods(node.attr) if isinstance(node, ast.Attribute) else []

    def methods(self, name: str) -> list[Function]:
        """Return every method of a name, of whatever class."""
        return self._methods.get(name, [])

    def _split(self, path: str) -> Key:
        """Return module and name of a dotted path, past what a module imports itself; of a foreign one, the path."""
        parts = path.split(".")
        for end in range(len(parts), 0, -1):
            module, name = ".".join(parts[:end]), ".".join(parts[end:])
            if module in self._modules:
                head, _, rest = name.partition(".")
                further = self._imported[module].get(head, set())
                if not self._is_defined((module, name)) and len(further) == 1 and (origin := next(iter(further))):
                    return self._split(f"{origin}.{rest}" if rest else origin)
                return module, name
        return path, ""

    def _is_defined(self, key: Key) -> bool:
        return key in self.functions or key in self._classes or (key[0], key[1].rpartition(".")[0]) in self._classes

    def _function(self, key: Key) -> Function | None:
        if key in self._classes:
            return self.method(key, "__init__")
        owner = (key[0], key[1].rpartition(".")[0])
        return self.functions.get(key) or (self.method(owner, key[1].rpartition(".")[2]) if owner[1] else None)

    def method(self, owner: Key, name: str, *, inherited: bool = False) -> Function | None:
        """Return the method of a class, from itself or else from what it inherits, or from the latter alone."""
        for module, each in (*(() if inherited else (owner,)), *self._ancestors.get(owner, ())):
            if (module, f"{each}.{name}") in self.functions:
                return self.functions[module, f"{each}.{name}"]
        return None

    def _base_classes(self, key: Key) -> Iterator[Key]:
        """Yield what a class inherits from, near before far; a foreign class as its path and an empty name."""
        module, _ = key
        for base in self._classes[key].bases:
            path = dotted_name(base.value if isinstance(base, ast.Subscript) else base) or "?"
            head, _, rest = path.partition(".")
            further = self._imported[module].get(head, set())
            outside = self._split(next(iter(further)) + (f".{rest}" if rest else "")) if further else (path, "")
            found = (module, path) if (module, path) in self._classes else outside
            yield found
            if found in self._classes:
                yield from self._base_classes(found)

    def _own_methods(self, key: Key) -> frozenset[str]:
        return frozenset(node.name for node in self._classes[key].body if isinstance(node, FunctionNode))

    def _is_port(self, key: Key) -> bool:
        return any(each[0].rpartition(".")[2] == "Protocol" for each in self._ancestors[key])

    def is_shaped_elsewhere(self, function: Function) -> bool:
        """Return whether a method's parameters are another's, of the house or foreign: a port's, or inherited ones."""
        if not function.owner:
            return False
        key, name = (function.source.module, function.owner), function.node.name
        if name == "__init__":
            return any(not each and path.rpartition(".")[2] != "Generic" for path, each in self._ancestors[key])
        own = self._own_methods(key).union(*(self._own_methods(one) for one in self._ancestors[key] if one[1]))
        below = (one for one, above in self._ancestors.items() if key in above)
        return (
            (name.startswith("__") and name.endswith("__"))
            or self._is_port(key)
            or any(name in port and port <= own for port in self._ports)
            or self.method(key, name, inherited=True) is not None
            or any(name in self._own_methods(one) for one in below)
            or any(not each and path.rpartition(".")[2] not in PLAIN for path, each in self._ancestors[key])
        )


PLAIN = frozenset({"ABC", "BaseModel", "Enum", "Exception", "Generic", "NamedTuple", "StrEnum", "object"})
"""Foreign classes whose methods nobody overrides by chance."""


def _field_names(source: Source) -> Iterator[str]:
    """Yield the name of each annotated field of a class, and of each attribute that is assigned to."""
    for node in source.nodes:
        match node:
            case ast.ClassDef(body=body):
                yield from (
                    e.target.id for e in body if isinstance(e, ast.AnnAssign) and isinstance(e.target, ast.Name)
                )
            case ast.Attribute(attr=name, ctx=ast.Store()):
                yield name


def _import_paths(source: Source) -> dict[str, set[str]]:
    """Return what each imported name in a file can stand for, by its dotted path, wherever in the file it is."""
    found: dict[str, set[str]] = defaultdict(set)
    for node in source.nodes:
        if isinstance(node, ast.Import):
            for each in node.names:
                found[each.asname or each.name.partition(".")[0]].add(
                    each.name if each.asname else each.name.partition(".")[0]
                )
        elif isinstance(node, ast.ImportFrom) and node.module:
            for each in node.names:
                found[each.asname or each.name].add(f"{node.module}.{each.name}")
    return found
