"""Small clean datasets of every kind that `palpate verify` reads, made through the product. All are SIMULATED."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.dataset import build, checks, register
from palpate.experiment.dataset.imports.imported import import_trials
from palpate.experiment.dataset.imports.layout import Layout
from palpate.experiment.dataset.imports.reconstruction import import_counts, study_text
from palpate.experiment.errors import DatasetError
from palpate.experiment.protocol import approval
from palpate.experiment.protocol.approval import sealing
from palpate.experiment.protocol.files import shipped
from palpate.experiment.records import chain
from palpate.experiment.records.entries import Header
from palpate.experiment.rehearsal import study as rehearsing
from palpate.experiment.rehearsal.clock import ManualClock
from palpate.experiment.session import attempt, runner
from palpate.experiment.session.kind import Sitting
from palpate.experiment.session.kinds.tapping.trials import ComparisonDevices
from palpate.experiment.session.laboratory import header
from palpate.experiment.study import enrolment, withdrawal
from palpate.experiment.study.people import enrolling
from palpate.experiment.study.roster import Revealed, Roster
from palpate.experiment.study.schedule import allocate
from tests.experiment.dataset.studies import DAY, MadeStudy, make_study
from tests.experiment.protocol.tapping import live_alone
from tests.experiment.session.kinds.tapping.bench import LayingConsole
from tests.experiment.session.scripted import START_NS
from tests.faults.wrong import base

REASON = "asked to stop"
PLANNED = {"participants = 15": "participants = 3", "participants = 10": "participants = 3"}
"""So few participants that the next ones take the place of those who withdrew."""

Lines = list[tuple[int, dict[str, object]]]
"""The time and the entry of each line of a journal or a roster."""


@dataclass(frozen=True)
class Clean:
    """A clean dataset; `tasks` are those of each participant in order, and `drawn` are draws the length of a journal.

    Beside the protocol stand a `register` of anchors where the dataset has any, and a `book` with the lines of a lab
    book.
    """

    study: MadeStudy
    tasks: dict[str, tuple[str, ...]]
    drawn: bool = False


def read_lines(path: Path) -> Lines:
    """Return the lines of a sound journal or roster."""
    return [(link.t_ns, dict(link.entry)) for link in chain.read(path, DatasetError).links]


def write_chain(path: Path, lines: Lines) -> None:
    """Write a journal or a roster anew, with its head, as palpate writes them."""
    path.unlink(missing_ok=True)
    chain.head_path(path).unlink(missing_ok=True)
    with closing(chain.Writer(path, chain.START)) as opened:
        for t_ns, entry in lines:
            opened.append(opened.next_link(t_ns, entry))


def anchor(study: MadeStudy) -> None:
    """Anchor a dataset in its log, in the register beside it, and in the lab book."""
    made, _ = checks.keep_anchor(study.root)
    register.enter(made, study.root, study.file.with_name("register"), None)
    with study.file.with_name("book").open("a", encoding="utf-8") as book:
        book.write(f"{made.line}\n")


def run_pairs(study: MadeStudy, asked: Header, keys: str) -> None:
    """Run a session of comparisons of real objects under this header, whatever it says."""
    clock = ManualClock(START_NS)
    console = LayingConsole(clock, keys)
    devices = attempt.Devices(
        kind=ComparisonDevices(), console=console, clock=clock, masker=None, reconnect_s=300.0, priority=""
    )
    rig_file = shipped("rigs/rehearsal.toml")
    runner.run(protocol=study.protocol, header=asked, devices=devices, rig_file=rig_file, dataset=study.root)


def _study(folder: Path) -> Clean:
    """Three are enrolled, the first two with a session each; nothing is anchored."""
    return _clean(base(folder))


def _anchored(folder: Path) -> Clean:
    made = base(folder)
    anchor(made)
    return _clean(made)


def _visits(folder: Path) -> Clean:
    """Four are enrolled: two sessions, the second with a pause, one and a paused one, one that goes on, and none.

    An anchor follows each session.
    """
    made = make_study(folder, enrolled=4, sessions=1)
    anchor(made)
    for place, position, keys in ((0, 1, "cq"), (0, 1, "apt"), (1, 0, "capt"), (1, 1, "cq"), (2, 0, "cq")):
        one = made.tasks[place]
        made.run(made.header(one.participant, one.tasks[position]), keys)
        build.build(made.root)
        anchor(made)
    one = made.tasks[2]
    made.run(made.header(one.participant, one.tasks[0]), "apt")
    under_way = made.journal(2)
    write_chain(under_way, read_lines(under_way)[:-1])
    return _clean(made)


def _people(folder: Path) -> Clean:
    """Three are planned. The second and third withdrew, with a session and without; two took their places.

    The fourth enrolled without consent at first. The fifth withdrew too, and their data were erased.
    """
    made = make_study(folder, enrolled=3, further=PLANNED)
    for participant in ("02", "03"):
        withdrawal.withdraw(made.file, participant, REASON, root=made.root, rebuild=build.build)
    for participant in ("04", "05"):
        enrolling.enrol(made.file, participant, None, root=made.root, seed=None)
        enrolment.consent(made.file, participant, DAY, root=made.root)
        tasks = {one.participant: one.tasks for one in made.tasks}
        made.run(made.header(participant, tasks[participant][0]))
    Roster.load(storage.roster_path(made.root)).append(Revealed, participant="01", revealed_on=DAY)
    build.build(made.root)
    anchor(made)
    withdrawal.withdraw(made.file, "05", REASON, root=made.root, rebuild=build.build, erase=True)
    anchor(made)
    return _clean(made)


def _pilot(folder: Path) -> Clean:
    return _clean(make_study(folder, pilot=True))


def _new(folder: Path) -> Clean:
    """Two are enrolled, and no session has begun."""
    return _clean(make_study(folder, sessions=0))


def _short_pairs(folder: Path) -> Path:
    """Write the shipped study of comparisons with each pair twice; return the file."""
    folder.mkdir(parents=True)
    text = live_alone(folder).read_text("utf-8")
    file = folder / "study.toml"
    file.write_text(re.sub(r"repetitions = \d+", "repetitions = 2", text).replace("limit = 108", "limit = 30"), "utf-8")
    return file


def _pairs(folder: Path) -> Clean:
    """A sealed study of comparisons: two sessions, one of them paused, and one participant without any."""
    file = _short_pairs(folder)
    made = MadeStudy(file, folder / "dataset")
    sealing.write(
        file,
        made.protocol,
        approval_number="17",
        board=made.protocol.ethics.board,
        approved_on=date(2001, 1, 1),
        expires_on=date(2099, 1, 1),
    )
    for participant in ("01", "02", "03"):
        enrolling.enrol(file, participant, DAY, root=made.root, seed=1)
    kept = approval.seal_path(storage.protocol_path(made.root))
    storage.write_bytes(kept, approval.seal_path(file).read_bytes())
    for participant, keys in (("01", "12" * 15), ("02", "12q")):
        run_pairs(made, made.header(participant, "live"), keys)
    build.build(made.root)
    anchor(made)
    return _clean(made)


def _rehearsal(folder: Path) -> Clean:
    """One participant rehearses both tasks of footsteps, with recordings."""
    made = make_study(folder / "other", enrolled=1, sessions=0)
    return _rehearsed(made.file.rename(folder / "study.toml"), 1, drawn=True)


def _rehearsed_pairs(folder: Path) -> Clean:
    """Two participants rehearse the comparisons."""
    return _rehearsed(_short_pairs(folder), 2)


def _rehearsed(file: Path, participants: int, *, drawn: bool = False) -> Clean:
    root = rehearsing.rehearse(
        protocol_file=file,
        rig_file=shipped("rigs/rehearsal.toml"),
        out=file.with_name("dataset"),
        participants=participants,
        seed=1,
    )
    return _planned(MadeStudy(file, root), drawn=drawn)


def _practice(folder: Path) -> Clean:
    """Practice of the comparisons, as far as the first participant."""
    made = MadeStudy(_short_pairs(folder), folder / "dataset")
    rig = rigs.load(shipped("rigs/rehearsal.toml"))
    plan = checks.Plan(
        label="PRACTICE",
        protocol_sha256=approval.sha256(made.protocol),
        rig_sha256=rigs.sha256(rig),
        participants=made.protocol.study.participants,
        seed=rehearsing.PRACTICE_SEED,
        control="none",
        real_time=True,
    )
    storage.write_json(storage.plan_path(made.root), plan.model_dump())
    storage.write_bytes(storage.protocol_path(made.root), made.file.read_bytes())
    asked = header(
        Sitting(
            protocol=made.protocol,
            rig=rig,
            rig_file=shipped("rigs/rehearsal.toml"),
            participant="01",
            task_id="live",
            dataset=made.root,
            recordings=None,
            clock=ManualClock(START_NS),
        ),
        position=1,
        seed=plan.seed,
        purpose="PRACTICE",
    )
    run_pairs(made, asked, "12" * 15)
    build.build(made.root)
    return _planned(made)


def _printed(folder: Path) -> Clean:
    """Counts from print, with no journal behind them."""
    counts = folder / "counts.csv"
    folder.mkdir(parents=True)
    counts.write_text("participant,presented,answered,count\n1,sand,sand,3\n1,snow,sand,2\n2,snow,snow,1\n", "utf-8")
    text = study_text("small", {"one": counts}, "Nowhere, page 7")
    return Clean(MadeStudy(counts, import_counts({"one": counts}, folder / "dataset", study=text)), {})


def _imported(folder: Path) -> Clean:
    """Trials that were measured elsewhere."""
    trials = folder / "trials.csv"
    folder.mkdir(parents=True)
    trials.write_text("who,shown,said\n1,felt,felt\n1,cork,felt\n2,felt,cork\n2,cork,cork\n", "utf-8")
    layout = Layout("shown", "said", "who")
    made = import_trials([trials], folder / "dataset", layout, study="lab", source="a lab")
    return Clean(MadeStudy(trials, made.root), {})


def _clean(made: MadeStudy) -> Clean:
    return Clean(made, {one.participant: one.tasks for one in made.tasks})


def _planned(made: MadeStudy, *, drawn: bool = False) -> Clean:
    return Clean(made, {one.participant: one.tasks for one in allocate(made.protocol, 1)}, drawn)


CLEAN: dict[str, Callable[[Path], Clean]] = {
    "study": _study,
    "anchored": _anchored,
    "visits": _visits,
    "people": _people,
    "pilot": _pilot,
    "new": _new,
    "pairs": _pairs,
    "rehearsal": _rehearsal,
    "rehearsed pairs": _rehearsed_pairs,
    "practice": _practice,
    "printed": _printed,
    "imported": _imported,
}
"""What each is called, and what makes it in a new folder: the protocol `study.toml`, and the folder `dataset`."""
