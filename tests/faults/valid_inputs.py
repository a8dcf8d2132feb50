"""A folder with a valid input of every kind that palpate reads, small and quick to read."""

from __future__ import annotations

import hashlib
import re
import shutil
import struct
from datetime import date
from pathlib import Path

from palpate.experiment.protocol import files
from palpate.experiment.protocol.approval import sealing
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal import study
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
from palpate.experiment.study.people import enrolling
from tests.analysis.datasets import balanced, write_dataset

PRINTED = """study = "madeup"
source = "Nobody: Nothing"
chance = "0.5"
task = [{ id = "live", participants = 7, trials = 10 }]
levels = [{ stars = "*", p = "0.05", above = true }]
t = [{ where = "page 2", tests = [{ task = "live", of = "sand", df = 6, t = "2.75", p = "0.033" }] }]
one_way = [{ where = "page 2", task = "live", pair = ["sand", "snow"], df = [3, 24], f = "2.12", p = "0.11" }]
two_way = [{ where = "page 2", effect = "task", df = [1, 92], f = "7.49", p = "7.43e-3" }]
icc = [{ where = "page 2", value = "0.97" }]
claim = [{ where = "page 1", task = "live", significant = 1, of = 2 }]
[[table]]
task = "live"
where = "Table 1"
cells = [
  { presented = "sand", answered = "sand", mean = "0.79", sd = "0.24", stars = "*" },
  { presented = "sand", answered = "snow", mean = "0.21", sd = "0.24" },
]
[[choices]]
task = "live"
where = "Table 2"
participants = 7
trials = 120
cells = [
  { pair = ["1", "1"], correct = "50%" },
  { pair = ["2", "1"], correct = "43%" },
]
"""
LVM = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Decimal_Separator\t.
X_Columns\tOne
***End_of_Header***\t
\t
Channels\t1\t
Samples\t12\t
Y_Unit_Label\tg\t
X0\t0.0\t
Delta_X\t0.001\t
***End_of_Header***\t\t
X_Value\tAcceleration\tComment
0.000\t0.5\t
0.001\t-0.25\t
0.002\t0.125\t
""" + "".join(f"0.{n:03d}\t{n % 3}.25\t\n" for n in range(3, 12))


def make_bench(folder: Path) -> Path:
    """A folder with a valid input of every kind."""
    folder.mkdir()
    text = shipped("okamoto2012.toml").read_text("utf-8")
    few = text.replace("limit = 36", "limit = 4")
    few = few.replace("[ethics]\n", "[ethics]\napproved_on = 2020-01-01\nexpires_on = 2030-01-01\n")
    for key, value in (("participants", 3), ("repetitions", 1)):
        few = re.sub(rf"{key} = \d+", f"{key} = {value}", few)
    protocol_file = folder / "study.toml"
    protocol_file.write_text(few, "utf-8")
    protocol = files.load(protocol_file)
    sealing.write(
        protocol_file,
        protocol,
        approval_number="1",
        board=protocol.ethics.board,
        approved_on=date(2020, 1, 1),
        expires_on=date(2030, 1, 1),
    )
    rows = shipped("rigs/rehearsal-response.csv").read_text("utf-8").splitlines()
    response = "\n".join(rows[:38]) + "\n"
    (folder / "response.csv").write_text(response, "utf-8")
    rig = shipped("rigs/rehearsal.toml").read_text("utf-8").replace("rehearsal-response.csv", "response.csv")
    (folder / "rig.toml").write_text(with_hash(rig, response.encode()), "utf-8")
    audio = shipped("rigs/headless.toml").read_text("utf-8")
    (folder / "audio.toml").write_text(audio, "utf-8")
    (folder / "printed.toml").write_text(PRINTED, "utf-8")
    shares = [0.4, 0.3, 0.2, 0.1]
    model = 'format = 1\nsource = "a pilot"\n' + "".join(
        f'[[rows]]\ntask = "{task.id}"\npresented = "{material.id}"\nanswers = {shares}\nspread = 0.1\n'
        for task in protocol.tasks
        for material in protocol.materials
    )
    (folder / "model.toml").write_text(model, "utf-8")
    made = recorded_takes.make_recordings(folder / "all", protocol=protocol, seed=1)
    _few_takes(made.parent, folder / "takes")
    wave = struct.pack("<16f", *range(16))
    header = struct.pack(
        "<4sI4s4sIHHIIHH4sI", b"RIFF", 36 + 64, b"WAVE", b"fmt ", 16, 3, 1, 1000, 4000, 4, 32, b"data", 64
    )
    (folder / "take.wav").write_bytes(header + wave)
    pcm = struct.pack(
        "<4sI4s4sIHHIIHH4sI", b"RIFF", 36 + 64, b"WAVE", b"fmt ", 16, 1, 2, 1000, 4000, 4, 16, b"data", 64
    )
    (folder / "pcm.wav").write_bytes(pcm + wave)
    (folder / "take.lvm").write_text(LVM, "utf-8")
    (folder / "take.csv").write_text(
        "time (s),acceleration (g)\n" + "".join(f"0.{n:03d},{n % 3}\n" for n in range(12)), "utf-8"
    )
    study.rehearse(
        protocol_file=protocol_file,
        rig_file=shipped("rigs/rehearsal.toml"),
        out=folder / "data",
        participants=1,
        seed=1,
    )
    enrolling.enrol(protocol_file, "01", date(2020, 5, 4), root=folder / "study", seed=5)
    write_dataset(folder / "tables", {"01": {"virtual": balanced(1)}}, tasks=("virtual",))
    (folder / "counts.csv").write_text("participant,presented,answered,count\n1,a,a,3\n1,b,a,2\n2,a,b,1\n", "utf-8")
    (folder / "trials.csv").write_text("who,shown,said\n1,a,a\n1,b,a\n2,a,b\n2,b,b\n", "utf-8")
    alike = "material_a,material_b,dissimilarity\nglass,sand,0.5\nglass,snow,0.25\nsand,snow,1\n"
    (folder / "alike.csv").write_text(alike, "utf-8")
    (folder / "junk").mkdir()
    (folder / "junk" / "note").write_text("something else", "utf-8")
    return folder


def with_hash(rig: str, response: bytes) -> str:
    """A rig file that names the hash of this response table."""
    return re.sub(r'(response_sha256 = )"\w+"', rf'\1"{hashlib.sha256(response).hexdigest()}"', rig)


def _few_takes(made: Path, folder: Path) -> None:
    """The first material's first take and the panel's, at the first speed."""
    head, *takes = (made / "manifest.toml").read_text("utf-8").split("[[takes]]")
    chosen = [next(t for t in takes if ("material" in t) is there) for there in (False, True)]
    folder.mkdir()
    (folder / "manifest.toml").write_text("[[takes]]".join([head, *chosen]), "utf-8")
    for take in chosen:
        name = take.split('file = "')[1].split('"')[0]
        shutil.copy(made / name, folder / name)
    shutil.rmtree(made)
