"""The participant's screen in a rig file: what is read, what is refused, and that it does not make another rig."""

from __future__ import annotations

from pathlib import Path

import pytest

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.display import ScreenKeys, ScreenRig, ScreenWords
from palpate.experiment.errors import RigError
from palpate.experiment.protocol.files import shipped

REHEARSAL = shipped("rigs/rehearsal.toml").read_text("utf-8")


def load(folder: Path, screen: str) -> rigs.Rig:
    file = folder / "rig.toml"
    file.write_text(f"{REHEARSAL}\n{screen}", "utf-8")
    return rigs.load(file)


def test_a_rig_may_have_a_screen_and_its_hash_stays(tmp_path: Path) -> None:
    plain = load(tmp_path, "")
    german = load(tmp_path, '[screen]\ndisplay = 1\n[screen.words]\nready = "Sie dürfen auftreten."\n')
    assert plain.screen is None
    assert german.screen == ScreenRig(display=1, words=ScreenWords(ready="Sie dürfen auftreten."))
    assert rigs.sha256(german) == rigs.sha256(plain)


def test_an_empty_table_is_a_full_screen_with_words_in_english(tmp_path: Path) -> None:
    assert load(tmp_path, "[screen]\n").screen == ScreenRig(fullscreen=True, display=0, keys=None, words=None)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ('[screen.keys]\nlouder = "Up"\n', r"screen\.keys\.louder: got 'Up'; allowed: a key as PsychoPy names it"),
        (
            '[screen.keys]\nlouder = "down"\n',
            r"screen\.keys\.louder: got 'down'; allowed: a key that differs from `softer`",
        ),
        (
            '[screen.keys]\nlouder = "a"\ndone = "a"\n',
            r"screen\.keys\.done: got 'a'; allowed: a key that differs from `louder`",
        ),
        ('[screen.words]\nready = ""\n', r"screen\.words\.ready: got ''; allowed: one line of text"),
        ('[screen.words]\nready = "a\\u202Eb"\n', r"screen\.words\.ready: got .*U\+202E"),
        ("[screen]\nwidth_px = 10\n", r"screen\.width_px: got 10; allowed: a whole number at least 320"),
        ("[screen]\nblinks = true\n", r"screen\.blinks: got true; allowed: no such key"),
    ],
)
def test_what_no_screen_can_have_is_refused(tmp_path: Path, table: str, said: str) -> None:
    with pytest.raises(RigError, match=said):
        load(tmp_path, table)


def test_the_keys_differ_by_default() -> None:
    assert len({*ScreenKeys().model_dump().values()}) == len(ScreenKeys.model_fields)
