"""A study runs under the approval of this very protocol, on its days, or not at all."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Any

import pytest
import rfc8785
from hypothesis import given
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from palpate.experiment.errors import OtherFormat, ProtocolError, Remedy
from palpate.experiment.protocol import approval
from palpate.experiment.protocol.approval import sealing, sha256
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.settings.characters import deceptive, hidden
from palpate.experiment.settings.load import written
from tests.approved import Refuses
from tests.experiment.protocol.small import SMALL, changed, document, protocol

APPROVAL: dict[str, Any] = {
    "approval_number": "2020-17",
    "board": "Board of tests",
    "approved_on": date(2020, 2, 1),
    "expires_on": date(2021, 2, 1),
}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(SMALL, encoding="utf-8")
    return path


def other() -> Protocol:
    return ProtocolFile.model_validate(changed(document(), ("study", "title"), "Another study"))


def test_a_sealed_protocol_may_run(file: Path) -> None:
    written = sealing.write(file, protocol(), **APPROVAL)
    form = approval.canonical(protocol()).decode()
    assert written == approval.Seal(format=1, protocol_sha256=sha256(protocol()), protocol=form, **APPROVAL)
    assert approval.verify(file, protocol(), date(2020, 6, 1)) == written
    assert sorted(path.name for path in file.parent.iterdir()) == ["small.seal.toml", "small.toml"]


@pytest.mark.parametrize(
    ("number", "maker"), [("", "an unreleased"), ("format = 0\n", "an unreleased"), ("format = 2\n", "a newer")]
)
def test_a_seal_of_another_format_is_no_damaged_one(file: Path, number: str, maker: str) -> None:
    path = file.parent / "small.seal.toml"
    sealing.write(file, protocol(), **APPROVAL)
    path.write_text(path.read_text("utf-8").replace("format = 1\n", number), "utf-8")
    with pytest.raises(OtherFormat, match=f"made by {maker} version") as refused:
        approval.verify(file, protocol(), date(2020, 6, 1))
    remedy = refused.value.finding.remedy
    assert isinstance(remedy, Remedy)
    assert remedy.command[:3] == ("palpate", "seal", str(file))
    assert {"--approval-number", "--approved-on", "--expires-on", "--replace"} < set(remedy.command)
    sealing.write(file, protocol(), **APPROVAL, replace=True)
    assert approval.verify(file, protocol(), date(2020, 6, 1)).format == 1


def test_the_seal_is_readable_as_it_stands(file: Path) -> None:
    sealing.write(file, protocol(), **APPROVAL)
    stated = tomllib.loads((file.parent / "small.seal.toml").read_text(encoding="utf-8"))
    assert json.loads(stated.pop("protocol"))["study"]["id"] == "small"
    assert stated == {"format": 1, "protocol_sha256": sha256(protocol()), **APPROVAL}


def test_a_seal_that_was_given_the_hash_of_another_version_is_refused(file: Path) -> None:
    """Only its number is edited; what it holds is still what was approved."""
    sealing.write(file, protocol(), **APPROVAL)
    seal = approval.seal_path(file)
    seal.write_text(seal.read_text("utf-8").replace(sha256(protocol()), sha256(other())), "utf-8")
    for read in (approval.verify, sealing.state):
        with pytest.raises(ProtocolError, match="the hash of the protocol text in the seal"):
            read(file, other(), date(2020, 6, 1))


def test_what_is_not_as_approved_is_told_where_the_board_reads(file: Path, approved: SnapshotAssertion) -> None:
    sealing.write(file, protocol(), **APPROVAL)
    told, _ = sealing.state(file, other(), date(2020, 6, 1))
    assert told == approved


@pytest.mark.parametrize("day", [date(2020, 2, 1), date(2021, 2, 1)])
def test_first_and_last_day_are_approved(file: Path, day: date) -> None:
    sealing.write(file, protocol(), **APPROVAL)
    assert approval.verify(file, protocol(), day).expires_on == date(2021, 2, 1)


@pytest.mark.parametrize(
    ("day", "match"),
    [
        (date(2020, 1, 31), r"approved_on: got 2020-02-01; .*wait"),
        (date(2021, 2, 2), "expires_on: .*has expired; have"),
    ],
)
def test_other_days_are_refused(file: Path, day: date, match: str) -> None:
    sealing.write(file, protocol(), **APPROVAL)
    with pytest.raises(ProtocolError, match=match):
        approval.verify(file, protocol(), day)


def test_a_seal_that_was_edited_to_an_impossible_day_is_refused_wherever_it_is_read(tmp_path: Path) -> None:
    approved_on = "1949-12-31"
    file, study = tmp_path / "small.toml", document()
    study["ethics"] = {"board": "Board of tests", "statement": "Nobody takes part."}
    bare = ProtocolFile.model_validate(study)
    sealing.write(file, bare, **APPROVAL)
    path = approval.seal_path(file)
    path.write_text(path.read_text("utf-8").replace("2020-02-01", approved_on).replace("2021", "2091"), "utf-8")
    today = date(2020, 6, 1)
    attempts: tuple[Callable[[], object], ...] = (
        lambda: approval.read(file),
        lambda: approval.dataset_seal(file, bare),
        lambda: sealing.state(file, bare, today),
        lambda: approval.verify(file, bare, today),
        lambda: sealing.write(
            tmp_path / "other.toml",
            bare,
            **{**APPROVAL, "approved_on": date.fromisoformat(approved_on), "expires_on": date(2099, 1, 1)},
        ),
    )
    for attempt in attempts:
        with pytest.raises(ProtocolError, match=r"approved_on: .*1950"):
            attempt()
    assert not (tmp_path / "other.seal.toml").exists()


def test_an_unsealed_protocol_is_refused(file: Path, refuses: Refuses) -> None:
    """A seal may have been lost, and then another must not take its place: restoring it comes first."""
    with refuses(ProtocolError):
        approval.verify(file, protocol(), date(2020, 6, 1))


@pytest.mark.parametrize(
    ("path", "value", "told"),
    [
        (
            ("study", "title"),
            "A small Study",
            r"study.title: got 'A small Study'; allowed: 'A small study', as approved",
        ),
        (("exposure", "masker_level_db_a"), 72, r"exposure.masker_level_db_a: got 72; allowed: 71, as approved"),
        (("answers", "redo_key"), "y", r"answers.redo_key: got 'y'; allowed: '/', as approved"),
        (
            ("eligibility", "criteria"),
            ("Grown up.",),
            r"eligibility.criteria\[1\]: got nothing; allowed: 'Rested.', as approved",
        ),
    ],
)
def test_a_changed_character_is_refused_and_names_its_field(
    file: Path, path: tuple[str, ...], value: object, told: str
) -> None:
    sealing.write(file, protocol(), **APPROVAL)
    with pytest.raises(ProtocolError, match=told):
        approval.verify(file, ProtocolFile.model_validate(changed(document(), path, value)), date(2020, 6, 1))


@given(
    path=st.sampled_from(sorted(approval.leaves(json.loads(approval.canonical(protocol()))), key=str)).map(
        lambda one: one[0]
    )
)
def test_any_one_value_that_differs_from_the_sealed_form_is_named(path: tuple[str | int, ...]) -> None:
    form = json.loads(approval.canonical(protocol()))
    inner: Any = form
    for part in path[:-1]:
        inner = inner[part]
    inner[path[-1]] = "another value"
    sealed = rfc8785.dumps(form)
    changed, more = approval.differences(protocol(), sealed.decode())
    assert ([field for field, _, _ in changed], more) == ([written(path)], 0)


def test_of_many_changes_a_few_are_named_and_the_rest_counted(file: Path, refuses: Refuses) -> None:
    sealing.write(file, protocol(), **APPROVAL)
    study = document()
    study["eligibility"]["criteria"] = tuple(f"Criterion {number}." for number in range(9))
    with refuses(ProtocolError):
        approval.verify(file, ProtocolFile.model_validate(study), date(2020, 6, 1))


@pytest.mark.parametrize("form", ["{}", "no JSON"])
def test_a_seal_without_the_form_that_it_names_refuses_a_change_all_the_same(
    file: Path, form: str | None, refuses: Refuses
) -> None:
    sealed = sealing.write(file, protocol(), **APPROVAL)
    sealing._write(approval.seal_path(file), sealed.model_copy(update={"protocol": form}))
    with refuses(ProtocolError):
        approval.verify(file, other(), date(2020, 6, 1))


def test_a_seal_whose_form_was_deleted_is_refused_whatever_hash_it_names(file: Path) -> None:
    sealing.write(file, protocol(), **APPROVAL)
    seal = approval.seal_path(file)
    kept = [line for line in seal.read_text("utf-8").splitlines(True) if not line.startswith("protocol =")]
    seal.write_text("".join(kept).replace(sha256(protocol()), sha256(other())), "utf-8")
    for read in (approval.verify, sealing.state):
        with pytest.raises(ProtocolError, match=r"small\.seal\.toml: 1 error\n.*protocol: got nothing; allowed: "):
            read(file, other(), date(2020, 6, 1))


LONG = "Taking part is voluntary. You may stop at any moment, without giving a reason. "


@pytest.mark.parametrize(
    ("was", "now", "told"),
    [
        (
            f"{LONG}We pay you.",
            f"{LONG}We do not pay you.",
            ("'...a reason. We do not pay you.'", "'...a reason. We pay you.'"),
        ),
        (LONG + "End.", LONG, ("'...giving a reason.'", "'...giving a reason. End.'")),
        ("\u7d19" * 70 + "a", "\u7d19" * 70 + "b", ("'..." + "\u7d19" * 20 + "b'", "'..." + "\u7d19" * 20 + "a'")),
        ("Short, and whole.", "Short, and other.", ("'Short, and other.'", "'Short, and whole.'")),
        (LONG, f"No. {LONG}", ("'No. Taking part is voluntary.", "'Taking part is voluntary.")),
    ],
)
def test_a_long_text_is_told_from_where_it_was_changed(file: Path, was: str, now: str, told: tuple[str, str]) -> None:
    before, after = (
        ProtocolFile.model_validate(changed(document(), ("consent", "statement"), text.strip())) for text in (was, now)
    )
    sealing.write(file, before, **APPROVAL)
    with pytest.raises(ProtocolError) as caught:
        approval.verify(file, after, date(2020, 6, 1))
    (found,) = (problem for problem in caught.value.findings if problem.field == "consent.statement")
    assert found.got.startswith(told[0])
    assert found.allowed.startswith(told[1])
    assert f"consent.statement is {found.got}, but" in sealing.state(file, after, date(2020, 6, 1))[0]


def test_a_protocol_changed_since_is_refused(file: Path, refuses: Refuses) -> None:
    sealing.write(file, protocol(), **APPROVAL)
    with refuses(ProtocolError):
        approval.verify(file, other(), date(2020, 6, 1))


def test_changed_and_expired_are_reported_together(file: Path) -> None:
    sealing.write(file, protocol(), **APPROVAL)
    with pytest.raises(ProtocolError) as caught:
        approval.verify(file, other(), date(2022, 1, 1))
    assert [problem.field for problem in caught.value.findings] == ["protocol_sha256", "study.title", "expires_on"]


def test_an_approval_that_contradicts_the_protocol_is_refused(file: Path, refuses: Refuses) -> None:
    with refuses(ProtocolError):
        sealing.write(file, protocol(), **{**APPROVAL, "expires_on": date(2021, 2, 2)})
    assert not (file.parent / "small.seal.toml").exists()


@pytest.mark.parametrize(
    ("field", "value", "match"),
    [
        ("approval_number", " ", "approval_number: got ' '; allowed: one line of text, not blank"),
        ("board", "", "board: got ''; allowed: text, not blank"),
        ("expires_on", date(2020, 2, 1), r"expires_on: .*a date after approved_on \(2020-02-01\)"),
    ],
)
def test_an_incomplete_approval_is_refused(file: Path, field: str, value: object, match: str) -> None:
    with pytest.raises(ProtocolError, match=match):
        sealing.write(file, protocol(), **{**APPROVAL, field: value})
    assert not (file.parent / "small.seal.toml").exists()


def test_a_slip_in_the_seal_of_the_same_protocol_is_mended_on_request_alone(file: Path, refuses: Refuses) -> None:
    sealing.write(file, protocol(), **APPROVAL)
    before = (file.parent / "small.seal.toml").read_bytes()
    mended = {**APPROVAL, "approval_number": "2020-18"}
    with refuses(ProtocolError):
        sealing.write(file, protocol(), **mended)
    assert (file.parent / "small.seal.toml").read_bytes() == before
    sealing.write(file, protocol(), **mended, replace=True)
    assert approval.verify(file, protocol(), date(2020, 6, 1)).approval_number == "2020-18"


def test_the_seal_of_another_form_is_replaced_on_request_alone(file: Path) -> None:
    sealing.write(file, protocol(), **APPROVAL)
    with pytest.raises(ProtocolError, match=r"replace it \(--replace\)"):
        sealing.write(file, other(), **APPROVAL)
    assert approval.verify(file, protocol(), date(2020, 6, 1))
    sealing.write(file, other(), **APPROVAL, replace=True)
    assert approval.verify(file, other(), date(2020, 6, 1)).protocol_sha256 == sha256(other())


def test_a_damaged_seal_is_refused_and_kept_until_it_is_replaced_on_request(file: Path) -> None:
    path = file.parent / "small.seal.toml"
    path.write_text("format = 1\nprotocol_sha256 = 'abc'\nboard = 3\n", encoding="utf-8")
    attempts: tuple[Callable[[], object], ...] = (
        lambda: approval.verify(file, protocol(), date(2020, 6, 1)),
        lambda: sealing.write(file, protocol(), **APPROVAL),
    )
    for attempt in attempts:
        with pytest.raises(ProtocolError, match="line 2: protocol_sha256: got 'abc'; allowed: 64 hexadecimal digits"):
            attempt()
    assert path.read_text(encoding="utf-8").startswith("format = 1\nprotocol_sha256 = ")
    sealed = sealing.write(file, protocol(), **APPROVAL, replace=True)
    assert approval.verify(file, protocol(), date(2020, 6, 1)) == sealed


@given(
    st.lists(st.characters(codec="utf-8").filter(lambda one: one == "\n" or not (hidden(one) or deceptive(one)))).map(
        lambda text: " ".join(["B", *text])
    )
)
def test_any_name_of_a_board_survives_the_file(tmp_path_factory: pytest.TempPathFactory, board: str) -> None:
    file = tmp_path_factory.mktemp("sealed") / "small.toml"
    named = ProtocolFile.model_validate(changed(document(), ("ethics", "board"), board))
    sealing.write(file, named, **{**APPROVAL, "board": board})
    assert approval.verify(file, named, date(2020, 6, 1)).board == board


def test_a_seal_of_another_board_than_the_pages_is_refused(file: Path, refuses: Refuses) -> None:
    with refuses(ProtocolError):
        sealing.write(file, protocol(), **{**APPROVAL, "board": "Another board"})


def test_in_a_sentence_whether_a_protocol_is_approved(file: Path, approved: SnapshotAssertion) -> None:
    unsealed, none = sealing.state(file, protocol(), date(2020, 6, 1))
    assert none is None
    seal = sealing.write(file, protocol(), **APPROVAL)
    sealed, same = sealing.state(file, protocol(), date(2021, 2, 1))
    later, _ = sealing.state(file, protocol(), date(2020, 1, 31))
    expired, _ = sealing.state(file, protocol(), date(2021, 2, 2))
    changed_since, of = sealing.state(file, other(), date(2020, 6, 1))
    assert same == of == seal
    assert [unsealed, sealed, later, expired, changed_since.split(",")[0]] == approved
    assert seal.protocol_sha256[:12] in changed_since


@pytest.mark.parametrize("digits", [8, 12, 64])
def test_a_seal_asks_for_the_page_that_the_board_read(file: Path, digits: int) -> None:
    page = approval.sha256(protocol())[:digits]
    assert sealing.write(file, protocol(), **APPROVAL, page_sha256=page.upper()).protocol_sha256.startswith(page)


@pytest.mark.parametrize("digits", ["0" * 12, sha256(other())[:12]])
def test_the_page_of_another_version_is_not_sealed(file: Path, digits: str, refuses: Refuses) -> None:
    with refuses(ProtocolError):
        sealing.write(file, protocol(), **APPROVAL, page_sha256=digits)
    assert not approval.seal_path(file).exists()


@pytest.mark.parametrize("digits", ["", "short", sha256(protocol())[:7], sha256(protocol()) + "0", "*" * 64])
def test_too_few_digits_of_the_page_are_no_other_version(file: Path, digits: str) -> None:
    said = rf"allowed: 8 to 64 hexadecimal digits \(there are {len(digits)}\); type the first digits"
    with pytest.raises(ProtocolError, match=said):
        sealing.write(file, protocol(), **APPROVAL, page_sha256=digits)
    assert not approval.seal_path(file).exists()
