"""What is counted in the syntax tree of one file: long-winded functions, sentences in tests, texts as arithmetic."""

from __future__ import annotations

import ast
import re
from collections.abc import Collection, Iterator
from typing import TypeGuard

from radon.visitors import ComplexityVisitor

from tests.measures.source import Source

GRADE_D = 21
"""The least cyclomatic complexity of radon's grade D."""

SENTENCE = 4
"""So many words, each of two letters or more, make part of a sentence."""


def complex_functions(source: Source) -> Iterator[str]:
    """Yield each function and method of grade D or worse, with its complexity; one inside of another counts alone."""
    visitor = ComplexityVisitor.from_ast(source.tree)
    ahead = [*visitor.functions, *(method for each in visitor.classes for method in each.methods)]
    while ahead:
        one = ahead.pop()
        ahead += one.closures
        if one.complexity >= GRADE_D:
            yield f"{source.path}:{one.lineno} {one.name} ({one.complexity})"


def sentence_assertions(source: Source) -> Iterator[str]:
    """Yield each `assert` that holds four words or more of a sentence: in one text, its own message included."""
    for node in source.nodes:
        if isinstance(node, ast.Assert) and _has_sentence(node):
            yield source.place(node)


def sentence_matches(source: Source) -> Iterator[str]:
    """Yield each `match=` of a call that holds four words or more of a sentence in one text."""
    for node in source.nodes:
        if isinstance(node, ast.Call):
            for given in node.keywords:
                if given.arg == "match" and _has_sentence(given.value):
                    yield source.place(given.value)


def _has_sentence(node: ast.AST) -> bool:
    return any(
        isinstance(each, ast.Constant)
        and isinstance(each.value, str)
        and len(re.findall(r"[A-Za-z]{2,}", each.value)) >= SENTENCE
        for each in ast.walk(node)
    )


def multiplied_texts(source: Source) -> Iterator[str]:
    """Yield each text that is multiplied by a condition: `"s" * (n != 1)`.

    A text of two letters or more counts if it is multiplied by anything that has a name, because nobody repeats a
    sentence: `" of 40" * several` counts, and `"-" * width` does not.
    """
    for node in source.nodes:
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
            for text, factor in ((node.left, node.right), (node.right, node.left)):
                if _is_text(text) and (_is_condition(factor) or (_is_name(factor) and _has_letters(text))):
                    yield source.place(node)


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str | bytes))


def _is_condition(node: ast.expr) -> bool:
    match node:
        case ast.Compare() | ast.BoolOp() | ast.UnaryOp(op=ast.Not()):
            return True
        case ast.Call(func=ast.Name(id="bool" | "any" | "all" | "isinstance")):
            return True
    return False


def _is_name(node: ast.expr) -> bool:
    return isinstance(node, ast.Name | ast.Attribute)


def _has_letters(text: ast.expr) -> bool:
    return any(
        isinstance(each, ast.Constant) and isinstance(each.value, str) and re.search(r"[A-Za-z]{2,}", each.value)
        for each in ast.walk(text)
    )


PARTS = {"split", "rsplit", "splitlines", "partition", "rpartition", "removeprefix", "removesuffix", "startswith"}
"""Methods that take a text apart, or ask for a part of it."""


def errors_in_text(source: Source, ours: Collection[str]) -> Iterator[str]:
    """Yield each place that takes an error of ours for a text, as `str(error)`, `f"{error}"` and `error.args` do, or
    that takes a text of it apart, as `error.finding.what.split(";")` does.

    So does whoever raises another error of its `sentence()` or its `cause`. An error is what `except` catches as one of
    `ours`, names of classes, and a parameter that is annotated as one.
    """
    for node in source.nodes:
        if isinstance(node, ast.ExceptHandler) and node.name and node.type and _names(node.type) & set(ours):
            yield from (source.place(use) for use in _texts_of(node, node.name))
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            for given in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs):
                if given.annotation and _names(given.annotation) & set(ours):
                    yield from (source.place(use) for use in _texts_of(node, given.arg))


def _names(node: ast.AST) -> set[str]:
    """Return every name in an annotation or behind `except`, a quoted one too."""
    found: set[str] = set()
    for each in ast.walk(node):
        match each:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.Constant(value=str(name)):
                found.update(re.findall(r"\w+", name))
    return found


def _is_sentence_of(node: ast.AST, name: str) -> TypeGuard[ast.expr]:
    match node:
        case ast.Call(func=ast.Attribute(value=ast.Name(id=used), attr="sentence")):
            return used == name
        case ast.Call(func=ast.Name(id="cause"), args=[ast.Name(id=used)]):
            return used == name
    return False


def _texts_of(block: ast.AST, name: str) -> Iterator[ast.expr]:
    """Yield each use of a name as a text."""
    for node in ast.walk(block):
        match node:
            case ast.Raise(exc=raised) if raised is not None:
                yield from (use for use in ast.walk(raised) if _is_sentence_of(use, name))
            case (
                ast.Call(func=ast.Name(id="str" | "repr" | "format" | "print"), args=[ast.Name(id=used), *_])
                | ast.FormattedValue(value=ast.Name(id=used))
                | ast.Attribute(value=ast.Name(id=used), attr="args" | "__str__" | "__repr__")
                | ast.BinOp(left=ast.Constant(value=str()), op=ast.Mod(), right=ast.Name(id=used))
            ) if used == name:
                yield node
            case ast.Call(func=ast.Attribute(value=taken, attr=part)) if part in PARTS:
                if any(isinstance(one, ast.Name) and one.id == name for one in ast.walk(taken)):
                    yield node
