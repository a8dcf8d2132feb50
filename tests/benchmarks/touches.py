"""Onset of the vibration at the touch through real parts: `python -m tests.benchmarks.touches [REPETITIONS [SEED]]`.

A SIMULATED hand taps virtual surfaces in real time behind a serial line, before the servo in its process and a
simulated force device; the vibrations sound on a JACK server of the rehearsal's, and the loopback hears them. Of each
touch: how far the onset that was heard is from the touch as the servo found it, both on the session's clock, all
together and where it was predicted in time. 2 repetitions take two minutes; the machine should do nothing else. Not a
test: it asserts nothing, because these figures belong to the machine that printed them.
"""

from __future__ import annotations

import re
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import journal
from palpate.experiment.records.kinds.tapping import Tapped
from palpate.experiment.rehearsal import study
from palpate.experiment.rehearsal.kinds.tapping import participant


def rig() -> str:
    """Return the tapping rig with the sound card of the headless one, whose actuator takes accelerations here."""
    hand, sound = (shipped(f"rigs/{name}.toml").read_text("utf-8") for name in ("tapping", "headless"))
    before, _, after = hand.partition("[actuator]")
    actuator = '[actuator]\ndriver = "audio"\nrate_hz = 48000\nfull_scale_m_s2 = 60.0\n\n'
    return before + actuator + after[after.index("\n[servo]") :] + sound[sound.index("\n[audio]") :]


def protocol(repetitions: int) -> str:
    """Return the paper's virtual task alone, with so many trials a pair and hardly a wait."""
    text = shipped("wellman1995.toml").read_text("utf-8")
    begins, ends = (text.index(f'[[tasks]]\nid = "{task}"') for task in ("live", "virtual"))
    text = (text[:begins] + text[ends:]).replace('["live", "virtual"]', '["virtual"]')
    for key, value in (("repetitions", f"{repetitions}"), ("min_s", "0"), ("max_s", "0.01"), ("limit", "1")):
        text = re.sub(rf"(?m)^{key} = \S+", f"{key} = {value}", text)
    return text


def main(repetitions: int = 2, seed: int = 1) -> None:
    participant.DECIDES_LOG_S, participant.LAYS_OUT_S = (-3.0, 0.1), (0.0, 0.01)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "study.toml").write_text(protocol(repetitions), "utf-8")
        (folder / "rig.toml").write_text(rig(), "utf-8")
        root = study.rehearse(
            protocol_file=folder / "study.toml",
            rig_file=folder / "rig.toml",
            out=folder / "made",
            participants=1,
            seed=seed,
            real_time=True,
        )
        [path] = root.glob("sourcedata/sub-01/*_journal.jsonl")
        taps = [entry for entry in journal.read(path).entries if isinstance(entry, Tapped)]
    late_ms, predicted = [], []
    for tap in taps:
        one = tap.onset.delivered
        if one is not None and one.onset_ns is not None:
            late_ms.append((one.onset_ns - tap.onset.contact_ns) / 1e6)
            predicted.append(tap.onset.scheduled_ns is not None)
    print(f"{len(taps)} touches, of which {len(late_ms)} were heard")
    for label, of in (("all", np.ones(len(late_ms), np.bool_)), ("predicted in time", np.array(predicted, np.bool_))):
        if (found := np.array(late_ms)[of]).size > 1:
            low, middle, high = np.percentile(found, (2.5, 50, 97.5))
            print(f"{label:<18} n {found.size:4d}  mean {found.mean():+.3f} ms  SD {found.std(ddof=1):.3f}  ", end="")
            print(f"2.5 % {low:+.3f}  median {middle:+.3f}  97.5 % {high:+.3f}")
    heard = [tap.onset.delivered for tap in taps if tap.onset.delivered is not None]
    reasons = Counter(re.sub(r" [-+\d.]+ ", " ... ", one.reason) for one in heard if not one.delivered)
    print("not as intended:", dict(reasons) or "none")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
