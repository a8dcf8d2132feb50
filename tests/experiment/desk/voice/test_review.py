"""A second rater: which answers are listened to, what is put on record, and how far both agree. Sounds are made up."""

from __future__ import annotations

import json
import stat
from pathlib import Path

import numpy as np
import pytest

from palpate.experiment import storage
from palpate.experiment.dataset import build, tables
from palpate.experiment.desk.voice import ear, review
from palpate.experiment.desk.voice.review import LOG, Agreement, Second, agreement, flag, rated, utterances
from palpate.experiment.errors import AudioError, DatasetError
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.records import journal
from palpate.experiment.records.entries import Answer, Spoken
from tests.approved import Refuses
from tests.conftest import Palpate
from tests.experiment.dataset.studies import MadeStudy, make_study

HEARD = Spoken(trial=1, attempt=1, onset_s=0.5, proposed="copy paper", agreement=0.9, lead=0.8)


@pytest.mark.parametrize(
    ("changed", "answered", "why"),
    [
        ({}, "copy paper", ""),
        ({}, "typing paper", "another answer was proposed"),
        ({}, None, "another answer was proposed"),
        ({"proposed": None}, "copy paper", "nothing was proposed"),
        ({"lead": 0.1}, "copy paper", "another answer matched almost as well"),
        ({"onset_s": None, "proposed": None}, "copy paper", "no speech was detected"),
        ({"onset_s": None, "proposed": None}, None, ""),
    ],
)
def test_what_is_listened_to_again(changed: dict[str, object], answered: str | None, why: str) -> None:
    assert flag(HEARD.model_copy(update=changed), answered) == why


def test_kappa_is_that_of_the_textbook(protocol: Protocol) -> None:
    # Fleiss, Levin and Paik, Statistical Methods for Rates and Proportions, 3rd ed., Table 18.1 and section 18.1:
    # 100 subjects, kappa 0.68 with a standard error of 0.087.
    one, other, third = (material.id for material in protocol.materials[:3])
    counts = {(one, one): 75, (one, other): 1, (one, third): 4, (other, one): 5, (other, other): 4, (other, third): 1}
    counts |= {(third, third): 10}
    pairs = [pair for pair, count in counts.items() for _ in range(count)]
    found = agreement(pairs, protocol)
    assert (found.pairs, found.alike) == (100, 89)
    assert found.kappa == pytest.approx(0.68, abs=0.005)
    assert found.low == pytest.approx(0.68 - 1.96 * 0.087, abs=0.01)
    assert found.high == pytest.approx(0.68 + 1.96 * 0.087, abs=0.01)
    assert "kappa 0.68, 95 % CI 0.5" in found.summary


def test_kappa_is_not_defined_where_all_is_one_answer(protocol: Protocol) -> None:
    one = protocol.materials[0].id
    assert agreement([], protocol) == Agreement(0, 0, None, None, None)
    assert agreement([(one, one)] * 5, protocol).kappa is None
    assert agreement([(None, None), (one, one)], protocol).kappa == 1.0


@pytest.fixture
def study(tmp_path: Path) -> MadeStudy:
    """One participant whose four answers were kept as sounds; the second was proposed otherwise."""
    made = make_study(tmp_path / "study", enrolled=1, sessions=1)
    (path,) = storage.journals(made.root)
    contents = journal.read(path)
    answers = [entry for entry in contents.entries if isinstance(entry, Answer)]
    footer = contents.entries[-1]
    from contextlib import closing

    from palpate.experiment.records.entries import Footer
    from palpate.experiment.rehearsal.clock import ManualClock

    assert isinstance(footer, Footer)
    with closing(journal.Journal(path, ManualClock(contents.lines[-1].t_ns), contents)) as opened:
        for number, one in enumerate(answers):
            content = ear.wav(np.full(800, 0.01 * (number + 1)))
            name = f"task-{contents.header.task}_trial-{one.trial:03d}_attempt-1.wav"
            ear.keep(storage.voices_folder(made.root, "01") / name, content)
            import hashlib

            proposed = "polypropylene" if number == 1 and one.answered != "polypropylene" else one.answered
            opened.append(
                Spoken(
                    trial=one.trial,
                    attempt=one.attempt,
                    onset_s=0.2,
                    proposed=None if number == 2 else proposed,
                    agreement=0.9,
                    lead=0.9,
                    sound=name,
                    sound_sha256=hashlib.sha256(content).hexdigest(),
                )
            )
        opened.append(footer)
    build.build(made.root)
    return made


def test_flagged_answers_and_a_share_are_listened_to(study: MadeStudy, refuses: Refuses) -> None:
    every = utterances(study.root, share=1.0, seed=1)
    assert len(every) == 4
    flagged = utterances(study.root, share=0.0, seed=1)
    assert {one.flagged for one in flagged} >= {"nothing was proposed"}
    assert set(flagged) <= set(every)
    assert utterances(study.root, share=1.0, seed=2) != every
    every[0].file.write_bytes(b"another")
    with refuses(DatasetError):
        utterances(study.root, share=1.0, seed=1)


def test_a_second_rater_hears_nothing_of_the_first(
    study: MadeStudy, palpate: Palpate, monkeypatch: pytest.MonkeyPatch
) -> None:
    every = utterances(study.root, share=1.0, seed=1)
    played: list[Path] = []
    monkeypatch.setattr(review, "play", lambda file, player: played.append(file))
    typed = iter(["r", "c", "zzz", "n", "?", "q"])
    monkeypatch.setattr("builtins.input", lambda prompt: next(typed))
    code, out, _ = palpate("answers", "review", study.root, "--by", "B", "--share", 1)
    assert code == 0
    assert played == [every[0].file, every[0].file, every[1].file, every[2].file, every[3].file]
    shown = out.partition("Second rater")[0]
    assert "presented" not in shown
    assert "proposed" not in shown
    found = rated(study.root, "B")
    assert [(found[one.sha256].answered, found[one.sha256].clear) for one in every[:3]] == [
        ("copy paper", True),
        (None, True),
        (None, False),
    ]
    assert rated(study.root, "C") == {}
    log = every[0].file.with_name(LOG)
    assert len(log.read_text("utf-8").splitlines()) == 3
    assert stat.S_IMODE(log.stat().st_mode) == 0o600
    assert Second.model_validate_json(log.read_text("utf-8").splitlines()[0]).by == "B"
    code, out, _ = palpate("answers", "review", study.root, "--by", "B", "--share", 1, "--list")
    assert (code, out.split()) == (0, [str(every[3].file)])
    code, out, _ = palpate("answers", "review", study.root, "--by", "B", "--share", 1, "--json")
    assert json.loads(out)["left"] == 1
    # What is beside the journals spoils no proof of the dataset.
    tables.check_tables(study.root)


def test_paths_are_printed_where_nothing_plays(
    study: MadeStudy, palpate: Palpate, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing(prompt: str) -> str:
        raise EOFError

    monkeypatch.setattr("builtins.input", nothing)
    one = utterances(study.root, share=1.0, seed=1)[0]
    code, out, _ = palpate("answers", "review", study.root, "--share", 1, "--paths")
    assert (code, out.splitlines()[0]) == (0, f"Answer 1 of 4: {one.file}")


def test_a_named_player_plays_and_its_failure_is_told(tmp_path: Path, refuses: Refuses) -> None:
    file = tmp_path / "a.wav"
    file.write_bytes(b"x")
    review.play(file, "test -s")
    with refuses(AudioError):
        review.play(file, "false")
    with refuses(AudioError):
        review.play(file, "no-such-player")


def test_erasing_takes_the_sounds_and_the_second_answers_along(study: MadeStudy, palpate: Palpate) -> None:
    folder = storage.voices_folder(study.root, "01")
    assert folder.exists()
    asked = ("withdraw", study.file, "--participant", "01", "--reason", "asked to stop", "--erase", "--yes")
    code, _, _ = palpate(*asked, "--dataset", study.root)
    assert code == 0
    assert not folder.exists()
