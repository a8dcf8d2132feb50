"""The board's page as one self-contained HTML file for a browser and for A4.

It is made of the same blocks as the plain text. Every text is escaped, and nothing in the file runs or is fetched. The
foot of every printed sheet names the version and whether it is approved.
"""

from collections.abc import Iterable
from datetime import date
from html import escape
from pathlib import Path

from palpate.experiment.protocol import approval, page
from palpate.experiment.protocol.approval import Seal
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.settings.characters import plain

NOTHING_RUNS = "default-src 'none'; style-src 'unsafe-inline'"
"""What a browser is told of the file, should an escape ever fail: nothing is fetched, and no script runs."""

_NAMES = str.maketrans({page.OPEN: '<span class="name">&quot;', page.CLOSE: "&quot;</span>", page.UNBROKEN: " "})


def html(
    protocol: Protocol, file: str, state: str, seal: Seal | None, today: date, rig: Iterable[page.Block] = ()
) -> str:
    """Return the page of the protocol in `file`, with `state` and `seal` of `approval.state`, and last the `rig`."""
    word = state.partition(":")[0]
    until = f" until {seal.expires_on}" if seal is not None and word == "SEALED" else ""
    said = page.Said(f"{state} This was so on {today}.")
    known: list[page.Block] = [said, page.approval_of(seal)] if seal else [said]
    parts = [f"<h1>{_own(page.heading(protocol))}</h1>", f'<div class="state">{_blocks(known)}</div>']
    parts.append(_blocks(page.title(protocol, file)))
    parts += [
        f"<section><h2>{place}. {_own(name)}</h2>{_blocks(blocks)}</section>"
        for place, (name, blocks) in enumerate(page.sections(protocol), start=1)
    ]
    if rig := tuple(rig):
        parts.append(f"<section><h2>{_own(page.OF_A_RIG)}</h2>{_blocks(rig)}</section>")
    foot = f"Study {protocol.study.id}, {word}{until}. SHA-256 of the protocol:"
    style = Path(__file__).with_name("page.css").read_text("utf-8")
    return (
        '<!DOCTYPE html>\n<html lang="en" dir="ltr"><head><meta charset="utf-8">'
        '<meta name="generator" content="palpate">'
        f'<meta http-equiv="Content-Security-Policy" content="{NOTHING_RUNS}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{_own(page.heading(protocol))}</title><style>\n{style}</style></head>\n"
        '<body><table class="sheet" role="presentation">'
        f'<tfoot><tr><td><p>{_own(foot)} <span class="hash">{approval.sha256(protocol)}</span></p></td></tr></tfoot>\n'
        f"<tbody><tr><td><main>{''.join(parts)}</main></td></tr></tbody></table></body></html>\n"
    )


def _own(text: str) -> str:
    """Return words of palpate, with the names in them kept whole."""
    return escape(text).translate(_NAMES)


def _free(text: str, of: str = "") -> str:
    """Return free text as a block of its own, which nothing in the text can leave."""
    return f'<blockquote dir="ltr"{of}>{escape(plain(text, keep=chr(10)))}</blockquote>\n'


def _blocks(blocks: Iterable[page.Block]) -> str:
    return "".join(map(_block, blocks))


def _block(block: page.Block) -> str:
    match block:
        case page.Said(text):
            return f"<p>{_own(text)}</p>\n"
        case page.Item(text):
            return f'<p class="item">{_own(text)}</p>\n'
        case page.Quoted(text, item):
            return _free(text, ' class="item"' if item else "")
        case page.Facts(known):
            said = (f'<tr><th scope="row">{_own(name)}</th><td>{_fact(value)}</td></tr>' for name, value in known)
            return f'<table class="facts">{"".join(said)}</table>\n'
        case page.Rows(rows):
            cells = "".join(f'<th scope="col">{_own(cell)}</th>' for cell in rows[0])
            body = "".join(f"<tr>{''.join(f'<td>{_own(cell)}</td>' for cell in row)}</tr>" for row in rows[1:])
            return f'<table class="rows"><thead><tr>{cells}</tr></thead><tbody>{body}</tbody></table>\n'
        case page.Gap():
            return ""


def _fact(value: str | page.Free) -> str:
    if isinstance(value, page.Free) and value.text:
        return _free(value.text)
    return _own((value.text if isinstance(value, page.Free) else value) or page.LEFT_EMPTY)
