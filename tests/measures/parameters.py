"""Parameters that nothing varies: every call in the source leaves them at their default, or gives the same literal.

What a function allows and no caller chooses is to leave. Not counted are parameters whose callers are not all known:
of a function that is used as a value or has a decorator that can call it, as commands do; of methods whose parameters
another class decides, as ports do; and of functions that nobody calls. A test is no caller.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from tests.measures.definitions import Definitions, Function, FunctionNode, dotted_name
from tests.measures.source import Source

HARMLESS = frozenset({"cache", "classmethod", "contextmanager", "lru_cache", "staticmethod"})
"""Decorators that call a function only when it is called."""

PROPERTIES = frozenset({"cached_property", "property"})
"""Decorators of methods that are used without a call."""


@dataclass(frozen=True)
class Unvaried:
    """A parameter that nothing varies."""

    function: Function
    parameter: str
    value: str
    """What it always is, as source."""
    has_default: bool

    @property
    def place(self) -> str:
        return f"{self.function.source.place(self.function.node)} {self.function.name}({self.parameter}={self.value})"


def unvaried_parameters(sources: Iterable[Source]) -> Iterator[Unvaried]:
    """Yield each parameter that no caller in these files varies."""
    sources = tuple(sources)
    definitions = Definitions(sources)
    for source in sources:
        _Calls(source, definitions).visit(source.tree)
    for function in definitions.functions.values():
        called_as_seen = HARMLESS.issuperset(function.decorators) and not function.is_passed_on
        if function.calls and called_as_seen and not definitions.is_shaped_elsewhere(function):
            yield from _unvaried_parameters(function)


def _unvaried_parameters(function: Function) -> Iterator[Unvaried]:
    arguments = function.node.args
    positional = [*arguments.posonlyargs, *arguments.args]
    defaults = dict(zip(reversed(positional), reversed(arguments.defaults), strict=False))
    defaults |= {each: one for each, one in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True) if one}
    calls = [_arguments(call, [each.arg for each in positional[function.is_bound :]]) for _, call in function.calls]
    for each in (*positional[function.is_bound :], *arguments.kwonlyargs):
        default = defaults.get(each)
        if isinstance(default, ast.Name) and default.id == each.arg:
            continue  # A closure in a loop keeps what it closes over.
        values = {_value(call, each.arg, default) for call in calls}
        if len(values) == 1 and (value := values.pop()) is not None:
            yield Unvaried(function, each.arg, value, has_default=default is not None)


def _arguments(call: ast.Call, positional: list[str]) -> dict[str, ast.expr]:
    """Return what a call gives, by the parameter; `*` stands for any number of the positional ones, `**` for any."""
    given = dict(zip(positional, call.args, strict=False))
    for number, each in enumerate(call.args):
        if isinstance(each, ast.Starred):
            given |= dict.fromkeys(positional[number:], each.value)
    return given | {each.arg or "**": each.value for each in call.keywords}


def _value(given: dict[str, ast.expr], parameter: str, default: ast.expr | None) -> str | None:
    """Return what a parameter gets, as source; None if that is no literal, and not its default."""
    found = given.get(parameter)
    if found is not None:
        return ast.unparse(found) if _is_literal(found) else None
    return None if default is None or "**" in given else ast.unparse(default)


def _is_literal(node: ast.expr) -> bool:
    try:
        ast.literal_eval(node)
    except (TypeError, ValueError):
        return False
    return True


class _Calls(ast.NodeVisitor):
    """Gives every function the calls of it in one file, and whether it is used there as a value."""

    def __init__(self, source: Source, definitions: Definitions) -> None:
        self._source = source
        self._definitions = definitions
        self._scopes: tuple[str, ...] = ("",)
        self._owner = ""
        self._local: frozenset[str] = frozenset()
        """Names that are variables here, whatever they mean elsewhere."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        self._visit_function(node)

    def visit_AsyncFunctionDef(self, node: ast.AsyncFunctionDef) -> None:
        self._visit_function(node)

    def _visit_function(self, node: FunctionNode) -> None:
        for each in (*node.decorator_list, *node.args.defaults, *filter(None, node.args.kw_defaults)):
            self.visit(each)
        self._inside(node.body, f"{node.name}.<locals>.", self._owner, _variables(node))

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        for each in (*node.decorator_list, *(keyword.value for keyword in node.keywords)):
            self.visit(each)
        self._inside(node.body, f"{node.name}.", self._scopes[0] + node.name, frozenset())

    def _inside(self, body: Iterable[ast.AST], scope: str, owner: str, local: frozenset[str]) -> None:
        before = self._scopes, self._owner, self._local
        self._scopes, self._owner = (f"{self._scopes[0]}{scope}", *self._scopes), owner
        self._local |= local
        for each in body:
            self.visit(each)
        self._scopes, self._owner, self._local = before

    def generic_visit(self, node: ast.AST) -> None:
        if isinstance(node, ast.Lambda):
            local = _parameters(node)
        elif isinstance(node, ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp):
            targets = (each for generator in node.generators for each in ast.walk(generator.target))
            local = frozenset(each.id for each in targets if isinstance(each, ast.Name))
        else:
            local = frozenset()
        before, self._local = self._local, self._local | local
        super().generic_visit(node)
        self._local = before

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_Call(self, node: ast.Call) -> None:
        for function in self._callees(node.func):
            function.calls.append((self._source, node))
        if dotted_name(node.func) is None:
            self.visit(node.func.value if isinstance(node.func, ast.Attribute) else node.func)
        # A class is asked for there, and not called.
        asks = isinstance(node.func, ast.Name) and node.func.id in ("isinstance", "issubclass")
        for each in (*node.args[: 1 if asks else None], *(keyword.value for keyword in node.keywords)):
            self.visit(each)

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> None:
        for each in node.body:
            self.visit(each)

    def visit_MatchClass(self, node: ast.MatchClass) -> None:
        for each in (*node.patterns, *node.kwd_patterns):
            self.visit(each)

    def _callees(self, node: ast.expr) -> list[Function]:
        own = self._own_method(node)
        return self._candidates(node) if own is None else [own]

    def _own_method(self, node: ast.expr) -> Function | None:
        """Return the method that an expression can only mean in the class that it is in; None if it is no such one."""
        owner = (self._source.module, self._owner)
        match node:
            case ast.Name(id="cls") if self._owner:
                return self._definitions.method(owner, "__init__")
            case ast.Attribute(value=ast.Call(func=ast.Name(id="super")), attr=name):
                return self._definitions.method(owner, name, inherited=True)
            case ast.Attribute(value=ast.Name(id="self" | "cls"), attr=name) if self._owner:
                return self._definitions.method(owner, name)
        return None

    def _candidates(self, node: ast.expr) -> list[Function]:
        match node:
            case ast.Attribute(value=ast.Call(func=ast.Name(id="super"))):
                return []  # A foreign class's.
        path = dotted_name(node)
        if path is not None and path.partition(".")[0] in self._local:
            return self._definitions.methods(path.rpartition(".")[2]) if "." in path else []
        return self._definitions.candidates(self._source.module, node, self._scopes)

    def visit_Name(self, node: ast.Name) -> None:
        self._pass_on(node)

    def visit_Attribute(self, node: ast.Attribute) -> None:
        self._pass_on(node)
        if dotted_name(node) is None:
            self.visit(node.value)

    def _pass_on(self, node: ast.Name | ast.Attribute) -> None:
        if isinstance(node.ctx, ast.Load):
            known = self._own_method(node)
            for function in self._candidates(node) if known is None else [known]:
                # Where `one.text` can be a value, it is: a method is seldom used without a call.
                can_be_value = known is None and isinstance(node, ast.Attribute) and bool(function.owner)
                if not (can_be_value and function.node.name in self._definitions.fields):
                    function.is_passed_on |= PROPERTIES.isdisjoint(function.decorators)


def _parameters(node: FunctionNode | ast.Lambda) -> frozenset[str]:
    every = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs, node.args.vararg, node.args.kwarg)
    return frozenset(each.arg for each in every if each is not None)


def _variables(node: FunctionNode) -> frozenset[str]:
    """Return the parameters of a function, and the names that it assigns to, those in its own functions left out."""
    found = set(_parameters(node))
    ahead: list[ast.AST] = list(node.body)
    while ahead:
        one = ahead.pop()
        if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store):
            found.add(one.id)
        elif not isinstance(one, FunctionNode | ast.ClassDef | ast.Lambda | ast.comprehension):
            ahead += ast.iter_child_nodes(one)
    return frozenset(found)
