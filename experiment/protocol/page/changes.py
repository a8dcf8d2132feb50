"""The page of an amendment: every field that differs between two versions of a protocol, old and new side by side."""

from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path
from textwrap import wrap

from palpate.experiment import storage
from palpate.experiment.protocol import approval
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.page import NOTHING_RUNS, rendering
from palpate.experiment.settings.characters import plain
from palpate.experiment.settings.load import written

COLUMN = (rendering.WIDTH - 5) // 2
"""Width of each version's column, characters."""

LEFT_OUT = "(not stated)"

Change = tuple[str, str, str]
"""A field as users read its path, its old value and its new one, each as text."""


def changes(old: Protocol, new: Protocol) -> tuple[Change, ...]:
    """Return every field that differs, in the order of the old version, then what is new."""
    was, now = (dict(approval.leaves(storage.json_of(approval.canonical(one)))) for one in (old, new))
    paths = [path for path in {**was, **now} if was.get(path, ...) != now.get(path, ...)]
    return tuple((written(path), _text(was.get(path, ...)), _text(now.get(path, ...))) for path in paths)


def _text(value: object) -> str:
    if value is ... or value is None:
        return LEFT_OUT
    return plain(" ".join(value.split()), keep="") if isinstance(value, str) else str(value)


def text(old: Protocol, new: Protocol) -> str:
    """Return the page in lines of at most `rendering.WIDTH` columns."""
    return "\n".join(_lines(old, new))


def _lines(old: Protocol, new: Protocol) -> Iterator[str]:
    yield f"Changes to the study {new.study.id}"
    yield "=" * rendering.WIDTH
    yield f"{'old version ' + approval.sha256(old)[:12]:{COLUMN}}  |  new version {approval.sha256(new)[:12]}"
    for field, was, now in changes(old, new):
        yield "-" * rendering.WIDTH
        yield field
        for one, other in zip_longest(wrap(was, COLUMN - 2), wrap(now, COLUMN - 2), fillvalue=""):
            yield f"  {one:{COLUMN - 2}}  |  {other}".rstrip()


def html(old: Protocol, new: Protocol, incidents: Sequence[str] = ()) -> str:
    """Return the page as one file of HTML for a browser and for A4, in which nothing runs or is fetched.

    Below the changes stand the `incidents` since the study began, in words.
    """
    listed = "".join(f"<li>{rendering.html_text(one)}</li>" for one in incidents) or "<li>None recorded.</li>"
    style = Path(__file__).with_name("page.css").read_text("utf-8")
    title = rendering.html_text(f"Changes to the study {new.study.id}")
    rows = "".join(
        f"<tr><th>{rendering.html_text(field)}</th><td>{rendering.html_text(was)}</td>"
        f"<td>{rendering.html_text(now)}</td></tr>"
        for field, was, now in changes(old, new)
    )
    heads = "".join(
        f"<th>{name} version<br>{approval.sha256(one)[:12]}</th>" for name, one in (("Old", old), ("New", new))
    )
    return (
        '<!DOCTYPE html>\n<html lang="en" dir="ltr"><head><meta charset="utf-8"><meta name="generator" '
        f'content="palpate"><meta http-equiv="Content-Security-Policy" content="{NOTHING_RUNS}">'
        f"<title>{title}</title><style>\n{style}\n"
        ".changes{border-collapse:collapse;width:100%}.changes td,.changes th{border:1px solid;padding:.3em;"
        "text-align:left;vertical-align:top;width:38%}</style></head>\n"
        f'<body><main><h1>{title}</h1><table class="changes"><tr><th>Field</th>{heads}</tr>{rows}</table>'
        f"<h2>Adverse events and deviations</h2><ul>{listed}</ul></main>"
        "</body></html>\n"
    )
