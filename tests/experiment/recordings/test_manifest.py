"""Recordings on disk: what was written loads again, and every damage is refused with its file and a remedy."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from palpate.experiment.errors import RecordingError
from palpate.experiment.protocol.kinds.footstep import Synthesis
from palpate.experiment.recordings.manifest import Recordings, load, load_all
from palpate.experiment.recordings.store import Take, write
from tests.approved import Refuses

SYNTHESIS = Synthesis(rate_hz=1000, samples=16, takes=2, speeds_mm_s=(50.0, 100.0))
MATERIALS = ("copy paper", "polypropylene 'film'")


def takes() -> list[Take]:
    rng = np.random.default_rng(1)
    return [
        Take(material, speed, number, rng.normal(size=16))
        for material in (None, *MATERIALS)
        for speed in SYNTHESIS.speeds_mm_s
        for number in (1, 2)
    ]


def written(directory: Path) -> Path:
    return write(directory, takes=takes(), rate_hz=1000, simulated=True, label='SIMULATED \\ "x"', note="a\nb")


def loaded(directory: Path, *materials: str) -> Recordings:
    return load(directory, synthesis=SYNTHESIS, material_ids=materials)


def first_wav(directory: Path, slug: str = "copy_paper") -> Path:
    return min(directory.glob(f"*_{slug}_50_1.wav"))


def trust_again(directory: Path, path: Path) -> None:
    """Put the present hash of a file into the manifest, as an experimenter would who changed it on purpose."""
    import hashlib

    manifest = directory / "manifest.toml"
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    entry = re.compile(rf'(file = "{path.name}"\n(?:.*\n)*?sha256 = ")[0-9a-f]+')
    manifest.write_text(entry.sub(rf"\g<1>{digest}", manifest.read_text()))


def test_what_was_written_loads_again(tmp_path: Path) -> None:
    written(tmp_path / "set")
    made = loaded(tmp_path / "set", *MATERIALS)
    assert (made.label, made.simulated, made.rate_hz) == ('SIMULATED \\ "x"', True, 1000)
    assert made.speeds_mm_s.tolist() == [50.0, 100.0]
    assert made.panel.shape == (2, 2, 16)
    expected = {(t.material, t.speed_mm_s, t.number): t.samples_m_s2.astype(np.float32) for t in takes()}
    for material, array in [(None, made.panel), *made.objects.items()]:
        for i, speed in enumerate(SYNTHESIS.speeds_mm_s):
            for j in range(2):
                np.testing.assert_array_equal(array[i, j], expected[material, speed, j + 1])


def test_files_are_float32_mono_wav(tmp_path: Path) -> None:
    written(tmp_path)
    rate_hz, samples = wavfile.read(first_wav(tmp_path))
    assert (rate_hz, samples.dtype, samples.shape) == (1000, np.float32, (16,))


def test_only_what_is_asked_for_is_opened(tmp_path: Path) -> None:
    written(tmp_path)
    for path in tmp_path.glob("*_polypropylene_*.wav"):
        path.unlink()
    assert set(loaded(tmp_path, "copy paper").objects) == {"copy paper"}


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    written(tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(RecordingError, match="already contains files"):
        written(tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_takes_of_unequal_length_are_not_written(tmp_path: Path, refuses: Refuses) -> None:
    uneven = [Take(None, 50.0, 1, np.zeros(3)), Take(None, 50.0, 2, np.zeros(4))]
    with refuses(RecordingError):
        write(tmp_path / "set", takes=uneven, rate_hz=1000, simulated=True, label="")


def test_takes_with_nan_are_not_written(tmp_path: Path, refuses: Refuses) -> None:
    with refuses(RecordingError):
        write(tmp_path, takes=[Take(None, 50.0, 1, np.array([np.nan]))], rate_hz=1000, simulated=True, label="")


def test_nothing_is_written_where_any_take_is_refused(tmp_path: Path, refuses: Refuses) -> None:
    good, bad = Take(None, 50.0, 1, np.zeros(2)), Take("copy paper", 50.0, 1, np.array([0.0, np.inf]))
    with refuses(RecordingError):
        write(tmp_path / "set", takes=[good, bad], rate_hz=1000, simulated=True, label="")
    assert not (tmp_path / "set").exists()


def edit(old: str, new: str) -> Callable[[Path], None]:
    def damage(directory: Path) -> None:
        manifest = directory / "manifest.toml"
        text = manifest.read_text()
        assert old in text
        manifest.write_text(text.replace(old, new, 1))

    return damage


def rewrite(rate_hz: int, samples: np.ndarray, *, trusted: bool = True) -> Callable[[Path], None]:
    def damage(directory: Path) -> None:
        wavfile.write(first_wav(directory), rate_hz, samples)
        if trusted:
            trust_again(directory, first_wav(directory))

    return damage


def nan_inside() -> np.ndarray:
    samples = np.zeros(16, np.float32)
    samples[3] = np.nan
    return samples


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (rewrite(2000, np.zeros(16, np.float32)), r"copy_paper_50_1.wav: got 2000 Hz; allowed: 1000 Hz"),
        (rewrite(1000, np.zeros(15, np.float32)), r"copy_paper_50_1.wav: got 15 samples; allowed: 16"),
        (rewrite(1000, np.zeros(16, np.int16)), r"got int16 samples; allowed: float samples"),
        (rewrite(1000, np.zeros((16, 2), np.float32)), r"got 2 channels; allowed: one"),
        (rewrite(1000, nan_inside()), r"got NaN or infinite samples"),
        (rewrite(1000, np.zeros(16, np.float32), trusted=False), r"got sha256 .*; allowed: .* manifest; restore"),
        (lambda d: first_wav(d).unlink(), r"copy_paper_50_1.wav: cannot be read .*; restore it"),
        (lambda d: first_wav(d).write_bytes(b"RIFFnonsense"), r"copy_paper_50_1.wav: the WAV file is damaged"),
        (lambda d: first_wav(d, "panel").unlink(), r"panel_50_1.wav: cannot be read"),
        (lambda d: (d / "manifest.toml").unlink(), r"manifest.toml: cannot be read"),
        (lambda d: (d / "manifest.toml").write_text("=\n"), r"manifest.toml: line 1: column 1: got .=.; allowed: TOML"),
        (lambda d: (d / "manifest.toml").write_bytes(b"\xff\xfe"), r"manifest.toml: line 1: .* not UTF-8"),
        (edit("rate_hz = 1000", "rate_hz = 5000"), r"rate_hz: got 5000; allowed: 1000, as in the protocol"),
        (edit("samples = 16", "samples = 2500"), r"samples: got 2500; allowed: 16, as in the protocol"),
        (edit("simulated = true", "simulated = 1"), r"simulated: got 1; allowed:"),
        (edit('unit = "m/s^2"', 'unit = "g"'), r"unit: got 'g'; allowed: .*m/s\^2"),
        (
            edit("note =", "nota ="),
            r"line 3: nota: got .*; allowed: no such key; did you mean 'note'\?.*; correct",
        ),
        (edit("samples = 16\n", ""), r"samples: got nothing; allowed: a whole number at least 1; correct the manifest"),
        (edit("rate_hz = 1000\nsamples = 16", "rate_hz = 0\nsamples = -1"), r"rate_hz: got 0; allowed: .* \(1 more\)"),
        (edit("number = 2", "number = 1"), r"for take 1 of the bare panel at 50 mm/s; allowed: one file"),
        (edit("number = 2", "number = 3"), r"got no take 2 of the bare panel at 50 mm/s; allowed: 2 takes"),
        (
            edit('file = "000_', 'file = "../000_'),
            r"takes\[0\].file: got '../000_panel_50_1.wav'; allowed: the name of",
        ),
    ],
)
def test_damage_is_refused_in_one_line(tmp_path: Path, damage: Callable[[Path], None], message: str) -> None:
    written(tmp_path)
    damage(tmp_path)
    with pytest.raises(RecordingError, match=message) as caught:
        loaded(tmp_path, "copy paper")
    assert "\n" not in str(caught.value)


def test_a_material_that_was_not_recorded_is_refused(tmp_path: Path, refuses: Refuses) -> None:
    written(tmp_path)
    with refuses(RecordingError):
        loaded(tmp_path, "cork")


def test_all_that_a_manifest_names_is_loaded(tmp_path: Path) -> None:
    written(tmp_path)
    whole, asked = load_all(tmp_path), loaded(tmp_path, *MATERIALS)
    assert list(whole.objects) == list(MATERIALS)
    assert whole.speeds_mm_s.tolist() == [50.0, 100.0]
    np.testing.assert_array_equal(whole.panel, asked.panel)
    for material in MATERIALS:
        np.testing.assert_array_equal(whole.objects[material], asked.objects[material])


def test_speeds_are_sorted_whatever_their_order_in_the_manifest(tmp_path: Path) -> None:
    write(tmp_path, takes=takes()[::-1], rate_hz=1000, simulated=True, label="")
    np.testing.assert_array_equal(load_all(tmp_path).panel, loaded(tmp_path).panel)


def test_one_speed_is_enough_for_fresh_takes(tmp_path: Path) -> None:
    write(tmp_path, takes=[t for t in takes() if t.speed_mm_s == 50], rate_hz=1000, simulated=True, label="")
    assert load_all(tmp_path).panel.shape == (1, 2, 16)


@pytest.mark.parametrize(
    ("kept", "message"),
    [
        (lambda t: t.material is None, "got 4 takes, but none of a material; allowed: takes of at least one material"),
        (lambda t: t.material is not None, "got no take 1 of the bare panel at 50 mm/s; allowed: 2 takes at each"),
        (lambda t: (t.material, t.speed_mm_s) != ("copy paper", 100.0), "got no take 1 of copy paper at 100 mm/s"),
        (lambda t: t.number == 1 or t.material != "copy paper", "got no take 2 of copy paper at 50 mm/s"),
    ],
)
def test_a_manifest_with_gaps_is_refused(tmp_path: Path, kept: Callable[[Take], bool], message: str) -> None:
    write(tmp_path, takes=filter(kept, takes()), rate_hz=1000, simulated=True, label="")
    with pytest.raises(RecordingError, match=message):
        load_all(tmp_path)


def test_achieved_speeds_stand_in_the_manifest_where_a_tracker_saw_them(tmp_path: Path) -> None:
    pair = [Take(None, 50.0, 1, np.zeros(2), achieved_mm_s=51.25), Take(None, 50.0, 2, np.zeros(2))]
    text = write(tmp_path, takes=pair, rate_hz=1000, simulated=True, label="").read_text("utf-8")
    assert text.count("achieved_mm_s") == 1
    assert "achieved_mm_s = 51.25\n" in text
