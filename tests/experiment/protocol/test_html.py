"""The page in HTML says what the page in text says, and no text of a file leaves its block, runs, or fetches."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from datetime import date
from html.parser import HTMLParser
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.experiment.protocol.approval import Seal, sha256
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.protocol.page import html, page
from palpate.experiment.settings.characters import JOINERS, hidden
from tests.experiment.protocol.small import changed, document, okamoto2012, protocol, with_text

TODAY = date(2020, 6, 1)
UNSEALED = "NOT SEALED: there is no approval next to this protocol file."
SEALED = "SEALED: this version is approved. Compare the seal with the board's letter."

HOSTILE = (
    "@<script>document.title='forged'</script></p></blockquote></td></tr></table></main>@<h2>@8.@Limits</h2>@"
    "</pre>@&lt;b&gt;@&amp;@&#60;i&#62;@<!--@]]>@<style>*{display:none}</style>@\"@'@<img src=x onerror=alert(1)>@"
)


def made(study: Protocol, file: str = "small.toml", state: str = UNSEALED, seal: Seal | None = None) -> str:
    return html(study, file, state, seal, TODAY)


@dataclass
class Read(HTMLParser):
    """What a browser would find: tags, text in words of palpate and in blocks of free text, and names."""

    tags: list[str] = field(default_factory=list)
    own: str = ""
    free: str = ""
    names: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag != "meta":
            self.open.append("name" if ("class", "name") in attrs else tag)
            self.names += [""] if self.open[-1] == "name" else []

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() in (tag, "name"), tag

    def handle_data(self, text: str) -> None:
        if "style" in self.open or "title" in self.open:
            return
        if "blockquote" in self.open:
            self.free += text
        elif "name" in self.open:
            self.names[-1] += text
            self.own += text
        else:
            self.own += f" {text} "


def read(text: str) -> Read:
    found = Read()
    found.feed(text)
    found.close()
    assert found.open == []
    return found


@pytest.mark.parametrize(
    "study", [protocol(), ProtocolFile.model_validate(okamoto2012())], ids=["small", "okamoto2012"]
)
def test_it_has_every_word_of_the_page_in_text_in_the_same_order(study: Protocol) -> None:
    in_text = re.sub(r"(?m)^[=-]{20,}$|^  (-+ *)+$|^  - |\|", " ", page(study, "small.toml"))
    browser = read(made(study).replace("<blockquote", "<p").replace("</blockquote", "</p"))
    _, _, after = browser.own.partition(f"(Status on {TODAY}.)")
    in_html = f"Protocol of the study {study.study.id} {after}"
    assert "".join(in_html.split()) == "".join(in_text.split())


@pytest.mark.parametrize("path", [path for path, _ in with_text()], ids=str)
def test_no_text_leaves_its_block(path: tuple[str | int, ...]) -> None:
    text = HOSTILE.replace("@", " @ ")
    quiet = read(made(ProtocolFile.model_validate(changed(document(), path, "@ quiet"))))
    found = read(made(ProtocolFile.model_validate(changed(document(), path, text))))
    assert found.tags == quiet.tags
    assert "".join(text.split()) in "".join(found.free.split())
    assert "@" not in found.own
    assert not {"script", "img", "a", "iframe", "link", "form"} & set(found.tags)


def test_names_and_the_file_stay_whole_and_in_their_place() -> None:
    name = "felt <b>&amp;</b> at most 3.0 m/s^2"
    study = changed(changed(document(), ("materials", 0, "id"), name), ("materials", 0, "spoken"), (name,))
    study = changed(study, ("materials", 1, "key"), '"')
    found = read(made(ProtocolFile.model_validate(study), "</td>@<h2>.toml"))
    assert found.names.count(f'"{name}"') == 3
    assert "3.0" not in found.own.replace(f'"{name}"', "")
    assert "</td>@<h2>.toml" in found.free
    assert '["] "cork"' in " ".join(found.own.split())


def test_nothing_is_fetched_and_nothing_may_run() -> None:
    text = made(protocol())
    policy = """<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'">"""
    assert text.index(policy) < text.index("<style>")
    assert not re.search(r"https?:|\burl\(|@import|\bsrc=|\bhref=|\bon\w+=", text)


def test_every_sheet_says_which_version_it_is_of_and_until_when_it_is_approved() -> None:
    # A browser repeats the foot of a table on every sheet.
    days: dict[str, Any] = {"approved_on": date(2020, 2, 1), "expires_on": date(2021, 2, 1)}
    form: dict[str, Any] = {"format": 1, "protocol_sha256": sha256(protocol()), "protocol": "{}"}
    seal = Seal(approval_number="17<", board="Board\nof tests", **form, **days)
    foot = r"<tfoot>.*Study small, {}\. SHA-256 of the protocol:.*" + sha256(protocol()) + ".*</tfoot>"
    assert re.search(foot.format("NOT SEALED"), made(protocol()))
    sealed = made(protocol(), state=SEALED, seal=seal)
    assert re.search(foot.format("SEALED until 2021-02-01"), sealed)
    assert "17<" in read(sealed).free
    later = made(protocol(), state="SEALED, BUT EXPIRED: the approval ended.", seal=seal)
    assert re.search(foot.format("SEALED, BUT EXPIRED"), later)
    assert "Expires on  2021-02-01" in re.sub(r"\s+", "  ", read(later).own).replace("Expires  on", "Expires on")


@given(st.data())
def test_no_accepted_text_shows_what_cannot_be_seen(data: st.DataObject) -> None:
    text = data.draw(st.text(st.characters(codec="utf-8"), min_size=1, max_size=12).map(lambda text: f"a{text}z"))
    path = data.draw(st.sampled_from([path for path, _ in with_text()]))
    try:
        study = ProtocolFile.model_validate(changed(document(), path, text))
    except ValueError:
        return
    shown = made(study)
    assert not hidden(shown, "\n" + JOINERS)
    assert "".join(text.split()) in "".join(read(shown).free.split())
