"""Nobody runs who may not, and the roster tells what happened."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from contextlib import closing
from datetime import date, timedelta
from pathlib import Path

import pytest

from palpate.experiment.errors import RosterError
from palpate.experiment.protocol.files import ProtocolFile
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import chain
from palpate.experiment.study.roster import Erased, Revealed, Roster
from tests.approved import Refuses
from tests.experiment.protocol.small import changed, document, protocol

TODAY = date(2020, 6, 1)


def may_run(roster: Roster, participant: str, study: Protocol) -> None:
    roster.may_run(participant, study, approved_on=TODAY - timedelta(9), today=TODAY)


@pytest.fixture
def roster(tmp_path: Path) -> Roster:
    return Roster.load(tmp_path / "study" / "roster.jsonl")


def test_a_participant_with_consent_may_run(roster: Roster) -> None:
    roster.enrol("01", TODAY)
    may_run(roster, "01", protocol())
    may_run(Roster.load(roster.path), "01", protocol())


def test_the_file_holds_labels_and_days_alone(roster: Roster) -> None:
    roster.enrol("01", TODAY)
    roster.enrol("02", None)
    roster.consent("02", TODAY)
    roster.correct("02", TODAY - timedelta(1), "the letter says so")
    roster.withdraw("01", "asked to stop")
    assert [json.loads(line)["entry"] for line in roster.path.read_text(encoding="utf-8").splitlines()] == [
        {"kind": "enrolled", "participant": "01", "consent_on": "2020-06-01", "approval": 1},
        {"kind": "enrolled", "participant": "02", "consent_on": None, "approval": 1},
        {"kind": "consented", "participant": "02", "consent_on": "2020-06-01", "approval": 1},
        {"kind": "corrected", "participant": "02", "consent_on": "2020-05-31", "reason": "the letter says so"},
        {"kind": "withdrawn", "participant": "01", "reason": "asked to stop"},
    ]
    read = Roster.load(roster.path)
    assert read == roster
    assert (read.consent_on, read.withdrawn) == ({"01": TODAY, "02": TODAY - timedelta(1)}, {"01": "asked to stop"})


def test_lines_are_only_ever_appended(roster: Roster) -> None:
    before = b""
    acts: tuple[Callable[[], object], ...] = (
        lambda: roster.enrol("01", TODAY),
        lambda: roster.enrol("02", TODAY),
        lambda: roster.withdraw("02", "moved away"),
    )
    for act in acts:
        act()
        now = roster.path.read_bytes()
        assert now.startswith(before)
        assert now.count(b"\n") == before.count(b"\n") + 1
        before = now


def test_each_line_has_its_number_and_time_and_the_hash_of_the_one_before(roster: Roster) -> None:
    roster.now_ns = iter((5, 9)).__next__
    roster.enrol("01", TODAY)
    roster.enrol("02", None)
    lines = roster.path.read_bytes().splitlines()
    hashes = [hashlib.sha256(line).hexdigest() for line in lines]
    read = [{name: json.loads(line)[name] for name in ("n", "t_ns", "prev")} for line in lines]
    assert read == [{"n": 0, "t_ns": 5, "prev": chain.GENESIS}, {"n": 1, "t_ns": 9, "prev": hashes[0]}]
    assert roster.lines.end.last == hashes[1]
    assert roster.path.with_suffix(".head").read_text() == f"000000000002 {hashes[1]}\n"


def test_a_roster_is_known_as_it_was_under_each_of_its_lines(roster: Roster, refuses: Refuses) -> None:
    roster.enrol("01", None)
    before = roster.lines.end.last
    roster.consent("01", TODAY)
    roster.withdraw("01", "asked to stop")
    then = Roster.load(roster.path).as_of(before)
    assert (then.consent_on, then.withdrawn) == ({"01": None}, {})
    with refuses(RosterError):
        roster.as_of(chain.GENESIS)


@pytest.mark.parametrize("days", [1, -10])
def test_nobody_runs_whose_consent_is_of_the_future_or_before_the_approval(
    roster: Roster, days: int, refuses: Refuses
) -> None:
    roster.enrol("01", TODAY + timedelta(days))
    with refuses(RosterError):
        may_run(roster, "01", protocol())
    roster.correct("01", TODAY, "the letter says so")
    may_run(roster, "01", protocol())


def test_only_a_consent_on_record_is_corrected(roster: Roster, refuses: Refuses) -> None:
    roster.enrol("01", None)
    with refuses(RosterError):
        roster.correct("01", TODAY, "the letter says so")
    roster.consent("01", TODAY)
    with refuses(RosterError):
        roster.correct("01", TODAY, "two\nlines")


def test_without_consent_nobody_runs(roster: Roster, refuses: Refuses) -> None:
    roster.enrol("01", None)
    with refuses(RosterError):
        may_run(roster, "01", protocol())
    roster.consent("01", TODAY)
    may_run(roster, "01", protocol())


def test_where_consent_is_not_required_none_is_asked_for(roster: Roster) -> None:
    roster.enrol("01", None)
    may_run(roster, "01", ProtocolFile.model_validate(changed(document(), ("consent", "required"), False)))


def test_who_withdrew_does_not_run(roster: Roster, refuses: Refuses) -> None:
    roster.enrol("01", TODAY)
    roster.withdraw("01", "asked to stop")
    with refuses(RosterError):
        may_run(roster, "01", protocol())


def test_who_is_not_enrolled_does_not_run(roster: Roster, refuses: Refuses) -> None:
    with refuses(RosterError):
        may_run(roster, "02", protocol())
    with refuses(RosterError):
        may_run(roster, "07", protocol())


@pytest.mark.parametrize("label", ["02", "1", "001", "first", "", "٠١"])
def test_participants_enrol_in_the_order_of_their_labels(roster: Roster, label: str, refuses: Refuses) -> None:
    roster.enrol("01", TODAY) if label == "001" else None
    with refuses(RosterError):
        roster.enrol(label, TODAY)


def test_a_place_is_given_once(roster: Roster, refuses: Refuses) -> None:
    roster.enrol("01", TODAY)
    with refuses(RosterError):
        roster.enrol("01", TODAY)


def test_wide_labels_stay_wide(roster: Roster, refuses: Refuses) -> None:
    roster.enrol("001", TODAY)
    with refuses(RosterError):
        roster.enrol("02", TODAY)
    roster.enrol("002", TODAY)


def test_what_has_happened_does_not_happen_again(roster: Roster, refuses: Refuses) -> None:
    roster.enrol("01", TODAY)
    with refuses(RosterError):
        roster.consent("01", TODAY)
    with refuses(RosterError):
        roster.append(Erased, participant="01")
    roster.withdraw("01", "asked to stop")
    with refuses(RosterError):
        roster.withdraw("01", "moved away")
    with refuses(RosterError):
        roster.correct("01", TODAY, "the letter says so")
    roster.append(Erased, participant="01")
    with refuses(RosterError):
        roster.append(Erased, participant="01")
    for known in ("01; the next label is 02", "01 to 02; the next label is 03"):
        said = f"participant '99' is not enrolled; allowed: {known}"
        with pytest.raises(RosterError, match=said):
            roster.withdraw("99", "asked to stop")
        roster.enrol(roster.next_label(), TODAY)


@pytest.mark.parametrize("reason", ["", " ", "two\nlines", "x" * 201, "a\x1b[2J", "a\u202eb", "a\u200bb"])
def test_a_reason_is_one_line(roster: Roster, reason: str, refuses: Refuses) -> None:
    roster.enrol("01", TODAY)
    with refuses(RosterError):
        roster.withdraw("01", reason)
    assert not roster.withdrawn


def test_two_consoles_never_give_one_place_twice(roster: Roster, refuses: Refuses) -> None:
    other = Roster.load(roster.path)
    roster.enrol("01", TODAY)
    with refuses(RosterError):
        other.enrol("01", TODAY)
    other.enrol("02", TODAY)
    assert list(Roster.load(roster.path).consent_on) == ["01", "02"]


def test_a_torn_last_line_was_never_confirmed(roster: Roster) -> None:
    roster.enrol("01", TODAY)
    whole = roster.path.read_bytes()
    roster.path.write_bytes(whole + b'{"n":1,"t_ns":')
    torn = Roster.load(roster.path)
    assert (list(torn.consent_on), torn.lines.end.torn) == (["01"], b'{"n":1,"t_ns":')
    torn.enrol("02", TODAY)
    assert list(Roster.load(roster.path).consent_on) == ["01", "02"]


@pytest.mark.parametrize(
    ("entry", "why"),
    [
        ({"kind": "enrolled", "participant": "02", "consent_on": None, "name": "x"}, "this is not a roster entry"),
        ({"kind": "enrolled", "participant": "03", "consent_on": None}, "got the label '03'; allowed: 02"),
        ({"kind": "withdrawn", "participant": "02", "reason": "x"}, "participant '02' is not enrolled"),
    ],
)
def test_a_line_that_cannot_be_trusted_is_refused_and_kept(roster: Roster, entry: dict[str, object], why: str) -> None:
    roster.enrol("01", TODAY)
    with closing(chain.Writer(roster.path, roster.lines.end)) as opened:
        opened.append(opened.next_link(1, entry))
    refused_and_kept(roster, f"roster.jsonl: line 2: {why}.*restore the roster from a backup")


def test_a_line_that_could_not_be_read_again_is_not_written(roster: Roster) -> None:
    roster.enrol("01", TODAY)
    before = roster.path.read_bytes()
    for label in ("half a character: \ud800", "0" * 2**8 + "\udfff"):
        with pytest.raises(RosterError, match="was not written"):
            roster.append(Revealed, participant=label, revealed_on=TODAY)
    roster.now_ns = lambda: 2**63
    with pytest.raises(RosterError, match="was not written"):
        roster.enrol("02", TODAY)
    assert roster.path.read_bytes() == before
    assert list(Roster.load(roster.path).consent_on) == ["01"]


@pytest.mark.parametrize(
    "line",
    [b"no json", b"\xff\xfe", b"[" * 10**5, b'{"kind": "enrolled", "participant": "02", "consent_on": null}'],
    ids=["words", "bytes", "nesting", "no chain"],
)
def test_a_line_without_a_chain_is_refused_and_kept(roster: Roster, line: bytes) -> None:
    roster.enrol("01", TODAY)
    roster.path.write_bytes(roster.path.read_bytes() + line + b"\n")
    refused_and_kept(roster, "roster.jsonl: line 2 is not a chained line.*restore it from a backup")


def refused_and_kept(roster: Roster, why: str) -> None:
    broken = roster.path.read_bytes()
    for act in (lambda: Roster.load(roster.path), lambda: roster.enrol("02", TODAY)):
        with pytest.raises(RosterError, match=why):
            act()
    assert roster.path.read_bytes() == broken
    assert list(roster.consent_on) == ["01"]


def test_a_folder_is_no_roster(tmp_path: Path) -> None:
    with pytest.raises(RosterError, match="cannot be read"):
        Roster.load(tmp_path)
