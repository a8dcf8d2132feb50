"""The base of every model of a settings file, and the reading of one, or its refusal with every problem at once.

A rule holds between fields. It reads a plain table (arrays as tuples) and ignores missing and mistyped values.

Problems are wrong types, missing and unknown keys, and broken rules, or the first syntax error, each with what is
allowed and its line. `tomllib` returns no lines, so `locate` finds them in a text that it has accepted.
"""

import dataclasses
import difflib
import functools
import json
import re
import tomllib
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import date, time
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, TypeVar, cast, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from palpate.experiment import storage
from palpate.experiment.errors import Finding, ProtocolError, mismatch
from palpate.experiment.settings import characters
from palpate.experiment.storage import Place

Table = Mapping[str, Any]

LARGEST = 2**20
"""No settings file is larger, bytes."""

MOST_TOLD = 1_000
"""A file with more fields that cannot be read is no such file: this many are told."""

LONGEST_SHOWN = 60
"""Characters: a longer number is cut, and of a longer array the length alone is told."""

MISSING = ("n/a", "N/A", "NA", "NaN", "nan", "None", "NULL", "null")
"""What programs read as a missing value, ours and those of who reads our tables."""

BROKEN_RULE = "broken_rule"
"""Type of the validation error that stands for broken rules."""

VISIBLE = "without control, invisible or look-alike characters or stray marks"
ONE_LINE = AfterValidator(characters.one_line)
"""Of a field with a pattern of its own: that it is one line of characters that `characters` allows."""

Remark = Annotated[str, Field(description=f"text {VISIBLE}"), AfterValidator(characters.free)]
Text = Annotated[str, Field(pattern=r"\S", description=f"text, not blank, {VISIBLE}"), AfterValidator(characters.free)]
Line = Annotated[str, Field(pattern=r"\S", description=f"one line of text, not blank, {VISIBLE}"), ONE_LINE]
Label = Annotated[
    str,
    Field(
        pattern=r"^[a-z][a-z0-9]{0,31}$",
        description="up to 32 lowercase letters and digits, starting with a letter (it becomes part of file names)",
    ),
]
Name = Annotated[
    str,
    Field(
        pattern=r"^[\p{L}\p{N}]([^\p{Cc}]{0,38}[^\s\p{Cc}])?$",
        description="one line of 1 to 40 characters that starts with a letter or digit, does not end with a space, "
        f"and contains no double quotes or right-to-left letters; {VISIBLE}",
    ),
    AfterValidator(characters.naming),
]
Key = Annotated[str, Field(pattern=r"^[!-@\[-~]$", description="one ASCII character, but no capital letter or space")]


@dataclass(frozen=True)
class Broken:
    """One rule that does not hold: the field to mend, from the table that was checked, and what it may be."""

    path: Place
    allowed: str


Rules = Callable[[Table], Iterable[Broken]]


def none(_table: Table) -> Iterable[Broken]:
    """Return no broken rule."""
    return ()


def written(path: Place) -> str:
    """Return a path as users read it: `tasks[0].order.kind`."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            bare = part.isascii() and part.replace("_", "a").replace("-", "a").isalnum()
            text += ("." if text else "") + (part if bare else f'"{part}"')
    return text


def toml(value: str | date) -> str:
    """Return a text or a day as a TOML file has it: JSON's escapes are TOML's, but TOML escapes DEL too."""
    if isinstance(value, date):
        return value.isoformat()
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def driver_key(*known: str) -> Any:
    """Return what a key `driver` may be: one of palpate's, or a lab's own."""
    allowed = f"{', '.join(known)}, or package.module:Class for your own driver"
    return Field(pattern=rf"^({'|'.join(known)}|[A-Za-z_][\w.]*:[A-Za-z_]\w*)$", description=allowed)


ADDRESS = re.compile(r"rehearsal|(\[[0-9A-Fa-f:.]+\]|[^\s:\[\]/]+):([0-9]{1,5})")


def port_rules(table: Any) -> Iterator[Broken]:
    """`address` is host:port with a port from 1 to 65535, or anything with a driver of one's own."""
    address = table.get("address")
    if isinstance(address, str) and ":" not in str(table.get("driver")):
        if (found := ADDRESS.fullmatch(address)) is None:
            yield Broken(("address",), "host:port, such as 127.0.0.1:4711, with a separate port for each server")
        elif found[2] and not 1 <= int(found[2]) <= 65535:
            yield Broken(("address",), "host:port with a port from 1 to 65535")


class Confined(BaseModel):
    """Base of every model: frozen, strict, no unknown key."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)

    RULES: ClassVar[Rules] = none

    @classmethod
    def renewed(cls, document: Table) -> Table:
        """Return a document as its newest format has it."""
        return document

    @classmethod
    def stated(cls, place: Place, document: Table) -> Place:  # noqa: ARG003
        """Return where a document states what stands at `place` of the renewed one."""
        return place

    @model_validator(mode="after")
    def _rules_hold(self) -> Self:
        broken = tuple(type(self).RULES(self.model_dump()))
        if broken:
            text = "; ".join(f"{written(one.path)}: allowed: {one.allowed}" for one in broken)
            raise PydanticCustomError(BROKEN_RULE, "{text}", {"text": text})
        return self


def younger(model: Confined, number: int, at: Place = ()) -> Iterator[Place]:
    """Yield the path of each key that came after the format `number`: `Field(json_schema_extra={"since": 3})`."""
    fields = type(model).model_fields
    for name, value in model:
        extra = fields[name].json_schema_extra
        if isinstance(extra, dict) and cast("int", extra.get("since", 0)) > number:
            yield (*at, name)
        elif isinstance(value, Confined):
            yield from younger(value, number, (*at, name))
        elif isinstance(value, tuple):
            for i, one in enumerate(value):
                if isinstance(one, Confined):
                    yield from younger(one, number, (*at, name, i))


Model = TypeVar("Model", bound=Confined)
Schema = Mapping[str, Any]

_MISSING = object()

_BLANK = re.compile(r"(?:[ \t\n]|#[^\n]*)*")
_KEY_PART = re.compile(r"[A-Za-z0-9_-]+|\"(?:[^\"\\\n]|\\.)*\"|'[^'\n]*'")
_DOT = re.compile(r"[ \t]*\.[ \t]*")
_STRING = re.compile(
    r'"""(?:[^\\]|\\.)*?"{3,5}(?!")'
    r"|'''.*?'{3,5}(?!')"
    r'|"(?:[^"\\\n]|\\.)*"'
    r"|'[^'\n]*'",
    re.DOTALL,
)
_BARE_VALUE = re.compile(r"[^,\]}#\n]+")


@dataclass(frozen=True)
class _File:
    """A text, which is the same wherever it stands."""

    text: str
    path: Path = dataclasses.field(compare=False)


def read(path: Path, model: type[Model]) -> Model:
    """Return the TOML file at `path` as a `model`. Raises `ProtocolError` with all problems, or of its syntax."""
    settings: Model = _read(_File(_text(path, LARGEST), path), model)
    return settings.model_copy()


@functools.lru_cache(maxsize=4)
def _read(file: _File, model: type[Model]) -> Model:
    """Return a file as a model: every session of a study keeps a copy of the same rig, and each is read."""
    document = _parsed(file)
    settings = checked(file.path, model, document, file.text)
    if too_young := tuple(younger(settings, number := document.get("format", 0))):
        lines = locate(file.text)
        newest = max(get_args(model.model_fields["format"].annotation))
        allowed = f"no such key in format {number}; leave it out, or write format = {newest}"
        problems = [mismatch(written(place), lines[place], "a key", allowed) for place in too_young if place in lines]
        if problems:
            raise ProtocolError.in_file(file.path, problems)
    return settings


def parsed(path: Path, most: int = LARGEST) -> tuple[dict[str, Any], str]:
    """Return the document and the text of a TOML file of at most `most` bytes. Raises `ProtocolError`."""
    file = _File(_text(path, most), path)
    return _parsed(file), file.text


def _parsed(file: _File) -> dict[str, Any]:
    document = _document(file.path, file.text)
    if found := storage.extreme(document):
        place, got = found
        line = None if got == storage.TOO_DEEP else _nearest(locate(file.text), place)
        raise ProtocolError.in_file(file.path, [mismatch(written(place)[:60], line, got, _NO_DEEPER)])
    return document


def checked(path: Path, model: type[Model], document: Mapping[str, Any], text: str = "") -> Model:
    """Return a parsed document as a `model`. Raises `ProtocolError` with all problems, on their lines in `text`."""
    frozen = _frozen(document)
    try:
        return model.model_validate(model.renewed(frozen))
    except ValidationError:
        if other := import_module("palpate.experiment.settings.other_files").error(path, model, document):
            raise other from None
        # A file without mistakes needs no lines.
        raise ProtocolError.in_file(path, find(model, frozen, locate(text))) from None


def _text(path: Path, most: int) -> str:
    if path.is_dir():
        raise ProtocolError.in_file(path, [mismatch("file", None, "a folder", _existing(path / "protocol.toml"))])
    try:
        data = storage.read_bytes(path, most)
    except FileNotFoundError as error:
        raise ProtocolError.in_file(path, [mismatch("file", None, "no such file", _existing(path))]) from error
    except OSError as error:
        got = f"a file that cannot be read ({error.strerror})"
        raise ProtocolError.in_file(path, [mismatch("file", None, got, "a readable TOML file")]) from error
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = data[: error.start]
        column = error.start - (before.rfind(b"\n") + 1) + 1
        raise ProtocolError.in_file(
            path,
            [
                mismatch(
                    f"byte {column} of the line",
                    before.count(b"\n") + 1,
                    f"the byte 0x{data[error.start]:02x}, which is not UTF-8",
                    "UTF-8 text; save the file in that encoding",
                )
            ],
        ) from error


def _existing(path: Path) -> str:
    files = sorted(file.name for file in path.parent.glob("*.toml")) if path.parent.is_dir() else []
    near = difflib.get_close_matches(path.name, files, n=1)
    suggestion = f"; did you mean {path.parent / near[0]}?" if near else ""
    return f"the path of a TOML file{suggestion}"


_NO_DEEPER = f"at most {storage.DEEPEST} levels, and 64-bit whole numbers; fix this first"

_LONG_KEY = re.compile(rf"(?<![\w-])(?:[\w-]+[ \t]*\.[ \t]*){{{3 * storage.DEEPEST}}}")
"""A key of so many parts: `tomllib` takes time by the square of their number, seconds for some thousands."""


def _document(path: Path, text: str) -> dict[str, Any]:
    if long := _LONG_KEY.search(text):
        at = text.count("\n", 0, long.start()) + 1
        raise ProtocolError.in_file(path, [mismatch(f"{long[0][:20]}...", at, storage.TOO_DEEP, _NO_DEEPER)])
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        # Before Python 3.14 the position stands in the message alone; numbers of absurd length have none.
        message, line, column, lines = str(error), None, None, text.split("\n")
        if "set_int_max_str_digits" in message:
            message = "numbers with fewer digits"
        if place := re.search(r" \(at (?:line (\d+), column (\d+)|end of document)\)$", message):
            message = message[: place.start()]
            line = int(place[1]) if place[1] else len(lines)
            column = int(place[2]) if place[2] else len(lines[-1]) + 1
        got = f"'{lines[line - 1].strip()[:60]}'" if line else "text that cannot be parsed"
        where = f"column {column}" if column else "file"
        raise ProtocolError.in_file(path, [mismatch(where, line, got, f"TOML; {message}; fix this first")]) from error


def _frozen(value: Any) -> Any:
    """Return arrays as tuples, which strict models ask for; every other type stays what TOML says it is."""
    if isinstance(value, dict):
        return {key: _frozen(held) for key, held in value.items()}
    if isinstance(value, list):
        return tuple(_frozen(held) for held in value)
    return value


def field(model: type[BaseModel], path: Place) -> str:
    """Return what the field at `path` inside a document of `model` may hold, in words."""
    root = _schema(model)
    return _in_words(root, _follow(root, path))


@functools.cache
def _schema(model: type[BaseModel]) -> Schema:
    return model.model_json_schema()


def _resolve(root: Schema, schema: Schema) -> Schema:
    if "$ref" in schema:
        return _resolve(root, root["$defs"][schema["$ref"].rpartition("/")[2]])
    if "anyOf" in schema:
        (only,) = (option for option in schema["anyOf"] if option.get("type") != "null")
        return _resolve(root, only)
    return schema


def _follow(root: Schema, path: Place) -> Schema:
    schema = root
    for part in path:
        schema = _resolve(root, schema["items"] if isinstance(part, int) else schema["properties"][part])
    return schema


def _in_words(root: Schema, schema: Schema) -> str:
    match schema:
        case {"const": only}:
            return str(only)
        case {"enum": options}:
            return f"one of: {', '.join(map(str, options))}"
        case {"type": "string", "format": "date"}:
            return "a date without quotes, such as 2012-04-01"
        case {"type": "string"}:
            return str(schema.get("description", "text"))
        case {"type": "integer"}:
            return _number("a whole number", schema)
        case {"type": "number"}:
            return _number("a number", schema)
        case {"type": "boolean"}:
            return "true or false"
        case {"type": "array", "items": items}:
            least, most = schema.get("minItems", 0), schema.get("maxItems")
            count = f" of {'' if least == most else 'at least '}{least}" if least else ""
            return f"an array{count}, each {_in_words(root, _resolve(root, items))}"
        case {"properties": properties}:
            required = schema.get("required", ())
            keys = (*required, *(f"{name} (optional)" for name in properties if name not in required))
            return f"a table with the keys: {', '.join(keys)}"
    raise NotImplementedError(f"no words for the schema {dict(schema)}")


def _number(noun: str, schema: Schema) -> str:
    bounds = (
        ("greater than", schema.get("exclusiveMinimum")),
        ("at least", schema.get("minimum")),
        ("less than", schema.get("exclusiveMaximum")),
        ("at most", schema.get("maximum")),
    )
    stated = " and ".join(f"{relation} {bound:.15g}" for relation, bound in bounds if bound is not None)
    return f"{noun} {stated}" if stated else noun


def find(model: type[Confined], document: Table, lines: Mapping[Place, int]) -> tuple[Finding, ...]:
    """Return every problem of `document` as a `model`, in the order of their lines as `locate` returns them."""
    newest = model.renewed(document)
    invalid = islice(_invalid_fields(model, newest), MOST_TOLD)
    found = {model.stated(path, document): words for path, words in (*invalid, *_broken_rules(model, newest))}
    problems = (
        mismatch(written(path), _nearest(lines, path), _shown(_value(document, path)), words)
        for path, words in found.items()
    )
    return tuple(sorted(problems, key=lambda problem: (problem.line or 0, problem.field)))


def _invalid_fields(model: type[Confined], document: Table) -> Iterator[tuple[Place, str]]:
    try:
        model.model_validate(document)
    except ValidationError as error:
        for one in error.errors(include_url=False):
            path = one["loc"]
            # Only valid elements are counted there: an array with a bad one is called too short though it is not.
            if one["type"] == "too_short" and len(one["input"]) >= one["ctx"]["min_length"]:
                continue
            if one["type"] == "extra_forbidden":
                known = sorted(_follow(_schema(model), path[:-1]).get("properties", {}))
                near = difflib.get_close_matches(str(path[-1]), known, n=1)
                suggestion = f"did you mean '{near[0]}'? " if near else ""
                yield path, f"no such key; {suggestion}allowed keys: {', '.join(known)}"
            elif one["type"] != BROKEN_RULE:
                yield path, field(model, path)


def _broken_rules(model: type[Confined], value: object, at: Place = ()) -> Iterator[tuple[Place, str]]:
    if not isinstance(value, Mapping):
        return
    for broken in model.RULES(value):
        yield (*at, *broken.path), broken.allowed
    for name, field in model.model_fields.items():
        nested = _model_in(field.annotation)
        if nested is None:
            continue
        held = value.get(name)
        if isinstance(held, tuple):
            for i, element in enumerate(held):
                yield from _broken_rules(nested, element, (*at, name, i))
        else:
            yield from _broken_rules(nested, held, (*at, name))


def _model_in(annotation: Any) -> type[Confined] | None:
    """Return the model of a field's table or tables, if it holds any."""
    if isinstance(annotation, type) and issubclass(annotation, Confined):
        return annotation
    return next((model for argument in get_args(annotation) if (model := _model_in(argument))), None)


def _nearest(lines: Mapping[Place, int], path: Place) -> int | None:
    while path and path not in lines:
        path = path[:-1]
    return lines.get(path)


def _value(document: object, path: Place) -> object:
    for part in path:
        if isinstance(document, Mapping):
            document = document.get(part, _MISSING)
        elif isinstance(document, tuple) and isinstance(part, int):
            document = document[part]
        else:
            return _MISSING
    return document


def _shown(value: object) -> str:
    if value is _MISSING:
        return "nothing"
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, tuple):
        flat = not any(isinstance(one, Mapping | tuple) for one in value)
        shown = f"[{', '.join(map(_shown, value[:LONGEST_SHOWN]))}]"
        return shown if value and flat and len(shown) <= LONGEST_SHOWN else f"an array of {len(value)}"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, date | time):
        return f"the date or time {value.isoformat()}"
    if isinstance(value, str):
        return characters.quoted(value)
    shown = str(value)
    return shown if len(shown) <= LONGEST_SHOWN else shown[: LONGEST_SHOWN - 3] + "..."


def locate(text: str) -> dict[Place, int]:
    """Return the line, from 1, on which each key, table and array element of a valid TOML text begins.

    A table has the line of its header, or of the first key that mentions it. Elements are numbered from 0.
    """
    return _Locator(text.replace("\r\n", "\n")).run()


class _Locator:
    def __init__(self, text: str) -> None:
        self._text = text
        self._at = 0
        self._newlines = [match.start() for match in re.finditer("\n", text)]
        self._lines: dict[Place, int] = {}
        self._elements: dict[Place, int] = {}
        self._headed: set[Place] = set()

    def run(self) -> dict[Place, int]:
        table: Place = ()
        while self._skip_blank() < len(self._text):
            if self._text[self._at] == "[":
                table = self._header()
            else:
                self._key_and_value(table)
        return self._lines

    def _line(self) -> int:
        return bisect_right(self._newlines, self._at) + 1

    def _skip_blank(self) -> int:
        self._take(_BLANK)
        return self._at

    def _take(self, pattern: re.Pattern[str]) -> str:
        match = pattern.match(self._text, self._at)
        if match is None:
            return ""
        self._at = match.end()
        return match.group()

    def _take_mark(self, mark: str) -> bool:
        self._skip_blank()
        if not self._text.startswith(mark, self._at):
            return False
        self._at += len(mark)
        return True

    def _key(self) -> tuple[str, ...]:
        parts = []
        while True:
            part = self._take(_KEY_PART)
            # Quoted keys hold escapes, which the parser itself decodes best.
            parts.append(next(iter(tomllib.loads(f"{part}=0"))) if part[0] in "\"'" else part)
            if not self._take(_DOT):
                return tuple(parts)

    def _header(self) -> Place:
        line = self._line()
        of_array = self._take_mark("[[")
        if not of_array:
            self._take_mark("[")
        self._skip_blank()
        *parents, last = self._key()
        self._take_mark("]]" if of_array else "]")
        path: Place = ()
        for part in parents:
            # The parent of a header is, of an array of tables, its latest element.
            path = (*path, part)
            self._lines.setdefault(path, line)
            path = (*path, self._elements[path] - 1) if path in self._elements else path
        path = (*path, last)
        if of_array:
            self._lines.setdefault(path, line)
            count = self._elements[path] = self._elements.get(path, 0) + 1
            path = (*path, count - 1)
        if path not in self._headed:
            self._headed.add(path)
            self._lines[path] = line
        return path

    def _key_and_value(self, table: Place) -> None:
        line = self._line()
        path = table
        for part in self._key():
            path = (*path, part)
            self._lines.setdefault(path, line)
        self._take_mark("=")
        self._skip_blank()
        self._value(path)

    def _value(self, path: Place) -> None:
        if self._take_mark("["):
            count = 0
            while not self._take_mark("]"):
                self._lines[*path, count] = self._line()
                self._value((*path, count))
                self._take_mark(",")
                count += 1
        elif self._take_mark("{"):
            while not self._take_mark("}"):
                self._key_and_value(path)
                self._take_mark(",")
        elif not self._take(_STRING):
            self._take(_BARE_VALUE)
