"""Datasets with one thing wrong in each: what is not theirs was put in, or what is theirs was changed."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from palpate.experiment import storage
from palpate.experiment.dataset import build, checks, register
from palpate.experiment.protocol import approval
from palpate.experiment.records import chain, journal
from palpate.experiment.study import withdrawal
from palpate.experiment.study.people import enrolling
from palpate.experiment.study.roster import Roster
from tests.experiment.dataset.studies import DAY, MadeStudy, make_study

Act = Callable[[MadeStudy, Path], None]
"""Does it to a study; the folder is for other datasets."""

THIRD = "03"
"""Is enrolled in the study and has no session."""


@dataclass(frozen=True)
class Wrong:
    """What is wrong, how it is done, and what is said then; `palpate build` mends what stands in tables alone."""

    name: str
    act: Act
    said: str
    mended: bool = False


def base(folder: Path) -> MadeStudy:
    """The study to which all of it is done: three enrolled, the first two with a session."""
    return make_study(folder, enrolled=3)


def copied(study: MadeStudy, folder: Path) -> MadeStudy:
    """The same study elsewhere."""
    shutil.copytree(study.file.parent, folder)
    return MadeStudy(folder / study.file.name, folder / study.root.name)


def headed(**changed: object) -> Act:
    def act(study: MadeStudy, _: Path) -> None:
        asked = study.header(THIRD, study.tasks[2].tasks[0])
        study.run(asked.model_copy(update=changed))

    return act


def _reordered(study: MadeStudy, _: Path) -> None:
    asked = study.header(THIRD, study.tasks[2].tasks[0])
    moved = zip(asked.order, reversed(asked.order), strict=True)
    order = tuple(one.model_copy(update={"presented": other.presented}) for one, other in moved)
    study.run(asked.model_copy(update={"order": order}))


def _not_enrolled(study: MadeStudy, _: Path) -> None:
    study.run(study.header("04", study.tasks[3].tasks[0]))


def _not_theirs(study: MadeStudy, _: Path) -> None:
    study.run(study.header("11", "virtual").model_copy(update={"task": "real"}))


def _of_another(study: MadeStudy, _: Path) -> None:
    own = journal.read(study.journal()).header
    study.run(study.header(THIRD, study.tasks[2].tasks[0]).model_copy(update={"session_id": own.session_id}))


def _moved(to: Callable[[Path, MadeStudy], Path], *, keep: bool) -> Act:
    def act(study: MadeStudy, _: Path) -> None:
        source = study.journal()
        target = to(source, study)
        target.parent.mkdir(exist_ok=True)
        for one, other in ((source, target), (chain.head_path(source), chain.head_path(target))):
            (shutil.copy if keep else shutil.move)(one, other)

    return act


def _third(source: Path, study: MadeStudy) -> Path:
    return study.journal(2)


def _other_task(source: Path, study: MadeStudy) -> Path:
    return storage.journal_path(study.root, "01", study.tasks[0].tasks[1])


def _from(**changed: object) -> Act:
    """The first participant's folder comes from another dataset."""

    def act(study: MadeStudy, folder: Path) -> None:
        other = make_study(folder / "other", enrolled=1, sessions=1, **changed)  # type: ignore[arg-type]
        place = storage.participant_folder(study.root, "01")
        shutil.rmtree(place)
        shutil.copytree(storage.participant_folder(other.root, "01"), place)

    return act


def _whole(where: str) -> Act:
    def act(study: MadeStudy, folder: Path) -> None:
        other = make_study(folder / "other", pilot=True, enrolled=1, sessions=1)
        shutil.copytree(other.root, study.root / where)

    return act


def _planned(label: str) -> Act:
    """A study's journals in the dataset of a rehearsal, or of practice, of the same protocol and seed."""

    def act(study: MadeStudy, _: Path) -> None:
        header = journal.read(study.journal()).header
        known = {"protocol_sha256": header.protocol_sha256, "rig_sha256": header.rig_sha256, "participants": 15}
        plan = {
            "format": storage.DATASET_FORMAT,
            "label": label,
            **known,
            "seed": 1,
            "control": "none",
            "real_time": False,
        }
        storage.write_json(storage.plan_path(study.root), plan)
        for path in (storage.roster_path(study.root), storage.seed_path(study.root)):
            path.unlink()
        chain.head_path(storage.roster_path(study.root)).unlink()

    return act


def _roster_in_rehearsal(study: MadeStudy, folder: Path) -> None:
    kept = folder / "roster.jsonl"
    shutil.copy(storage.roster_path(study.root), kept)
    _planned("REHEARSAL")(study, folder)
    shutil.copy(kept, storage.roster_path(study.root))


def _replaced(path: Callable[[MadeStudy], Path], old: bytes, new: bytes) -> Act:
    def act(study: MadeStudy, _: Path) -> None:
        data = path(study).read_bytes()
        assert old in data
        path(study).write_bytes(data.replace(old, new, 1))

    return act


def _reseeded(study: MadeStudy, _: Path) -> None:
    _seed(study).write_text(f'{{"format": {storage.DATASET_FORMAT}, "seed": 2, "purpose": "STUDY"}}', "utf-8")


def _gone(*paths: Callable[[MadeStudy], Path]) -> Act:
    def act(study: MadeStudy, _: Path) -> None:
        for path in paths:
            path(study).unlink()

    return act


def _protocol(study: MadeStudy) -> Path:
    return storage.protocol_path(study.root)


def _seal(study: MadeStudy) -> Path:
    return approval.seal_path(storage.protocol_path(study.root))


def _roster(study: MadeStudy) -> Path:
    return storage.roster_path(study.root)


def _head(path: Callable[[MadeStudy], Path]) -> Callable[[MadeStudy], Path]:
    return lambda study: chain.head_path(path(study))


def _seed(study: MadeStudy) -> Path:
    return storage.seed_path(study.root)


def _foot(study: MadeStudy) -> Path:
    return storage.foot_path(study.journal())


def _events(study: MadeStudy) -> Path:
    name = study.journal().name.replace("_journal.jsonl", "_events.tsv")
    return study.root / "sub-01" / "beh" / name


def _sidecar(study: MadeStudy) -> Path:
    return _events(study).with_suffix(".json")


def _people(study: MadeStudy) -> Path:
    return study.root / "participants.tsv"


def _description(study: MadeStudy) -> Path:
    return study.root / "dataset_description.json"


def _emptied(study: MadeStudy, _: Path) -> None:
    """Without its tables: nothing but the raw frames knows of the session."""
    study.journal().write_bytes(b"")
    chain.head_path(study.journal()).unlink()
    shutil.rmtree(study.root / "sub-01")


def _erased(study: MadeStudy, _: Path) -> None:
    """All of a session but its raw frames and its rig."""
    study.journal().unlink()
    chain.head_path(study.journal()).unlink()
    shutil.rmtree(study.root / "sub-01")


def _without_folders(study: MadeStudy, _: Path) -> None:
    """All of a participant but their row in the table of participants."""
    for folder in (storage.participant_folder(study.root, "02"), study.root / "sub-02"):
        shutil.rmtree(folder)


def _erased_but_for_the_roster(study: MadeStudy, folder: Path) -> None:
    checks.keep_anchor(study.root)
    _without_folders(study, folder)
    people = _people(study).read_text("utf-8").splitlines(keepends=True)
    _people(study).write_text("".join(line for line in people if not line.startswith("sub-02")), "utf-8")


def _erased_everywhere(study: MadeStudy, folder: Path) -> None:
    """A participant whom nothing knows but the dataset's log of anchors."""
    shutil.copytree(study.root, folder / "before")
    enrolling.enrol(study.file, "04", DAY, root=study.root, seed=None)
    study.run(study.header("04", study.tasks[3].tasks[0]))
    checks.keep_anchor(study.root)
    log = (study.root / register.LOG).read_bytes()
    shutil.rmtree(study.root)
    shutil.copytree(folder / "before", study.root)
    (study.root / register.LOG).write_bytes(log)


def _stray_trace(study: MadeStudy, _: Path) -> None:
    name = _events(study).name
    (_events(study).parent / name.replace("sub-01", f"sub-{THIRD}").replace("_events", "_physio")).write_bytes(b"1\n")


def _forgotten(participant: str, rebuild: Callable[[Path], object] = build.build) -> Act:
    """A withdrawal, and then the roster and its head as they were before."""

    def act(study: MadeStudy, folder: Path) -> None:
        files = (_roster(study), chain.head_path(_roster(study)))
        for file in files:
            shutil.copy(file, folder / file.name)
        withdrawal.withdraw(study.file, participant, "asked to stop", root=study.root, rebuild=rebuild)
        for file in files:
            shutil.copy(folder / file.name, file)

    return act


def _written_anew(study: MadeStudy, _: Path) -> None:
    """The same people on the same days, in a chain and a head that fit."""
    _write_anew(study, Roster.load(_roster(study)).seed_sha256)


def _written_anew_without_the_hash(study: MadeStudy, _: Path) -> None:
    _write_anew(study, None)


def _write_anew(study: MadeStudy, seed_sha256: str | None) -> None:
    known = Roster.load(_roster(study)).consent_on
    _gone(_roster, _head(_roster))(study, study.root)
    for participant, day in known.items():
        Roster.load(_roster(study)).enrol(participant, day, seed_sha256=seed_sha256)


def _consent_later(study: MadeStudy, _: Path) -> None:
    Roster.load(_roster(study)).correct("01", date(2001, 9, 20), "the letter says so")


def _consent_before_approval(study: MadeStudy, _: Path) -> None:
    Roster.load(_roster(study)).correct("01", date(2000, 9, 20), "the letter says so")


def _unfinished_withdrawal(study: MadeStudy, _: Path) -> None:
    """As a kill leaves it after the roster's line."""
    Roster.load(_roster(study)).withdraw("01", "asked to stop")


def _foreign_events(study: MadeStudy, _: Path) -> None:
    target = study.root / "sub-03" / "beh" / "sub-03_task-real_events.tsv"
    target.parent.mkdir(parents=True)
    shutil.copy(_events(study), target)


def _first_cell(study: MadeStudy, _: Path) -> None:
    """The first answer becomes another material."""
    lines = _events(study).read_text("utf-8").split("\n")
    cells = lines[1].split("\t")
    place = lines[0].split("\t").index("answered")
    cells[place] = "typing paper" if cells[place] != "typing paper" else "copy paper"
    _events(study).write_text("\n".join([lines[0], "\t".join(cells), *lines[2:]]), "utf-8")


def _fewer_rows(study: MadeStudy, _: Path) -> None:
    """A trial is left out of the table and of its count."""
    lines = _events(study).read_text("utf-8").split("\n")
    _events(study).write_text("\n".join([*lines[:2], *lines[3:]]), "utf-8")
    sidecar = json.loads(_sidecar(study).read_text("utf-8"))
    storage.write_json(_sidecar(study), {**sidecar, "Rows": sidecar["Rows"] - 1})


WRONG = (
    Wrong("a rehearsal's journal in a study", headed(purpose="REHEARSAL"), "purpose REHEARSAL; allowed: STUDY"),
    Wrong("a pilot's journal in a study", headed(purpose="PILOT"), "purpose PILOT; allowed: STUDY"),
    Wrong("a journal of practice in a study", headed(purpose="PRACTICE"), "purpose PRACTICE; allowed: STUDY"),
    Wrong("a study's journal in a rehearsal", _planned("REHEARSAL"), "purpose STUDY; allowed: REHEARSAL"),
    Wrong("a study's journal in practice", _planned("PRACTICE"), "purpose STUDY; allowed: PRACTICE"),
    Wrong("a roster in a rehearsal", _roster_in_rehearsal, "does not belong to a rehearsal"),
    Wrong("a journal of another study's id", headed(study="other"), "study other; allowed: okamoto2012"),
    Wrong("a journal of another protocol", headed(protocol_sha256="0" * 64), "protocol_sha256 0000"),
    Wrong("a journal of another seed", headed(seed=2), "seed 2; allowed: 1"),
    Wrong("a journal of another order", _reordered, "a different order of trials"),
    Wrong("a journal of another turn", headed(task_position=2), "task_position 2; allowed: 1"),
    Wrong("a journal of other blocks", headed(block_trials=2), "block_trials 2; allowed: 4"),
    Wrong(
        "a journal under another roster", headed(roster_sha256="0" * 64), "is missing a line that a session depends on"
    ),
    Wrong("a journal under no roster", headed(roster_sha256=None), "is missing a line that a session depends on"),
    Wrong("a journal of nobody enrolled", _not_enrolled, "participant 04 is not enrolled"),
    Wrong("a journal of nobody in the study", headed(participant="16"), "participant 16; allowed: 01 to 15"),
    Wrong("a journal of a task that is not theirs", _not_theirs, "task real; allowed: virtual"),
    Wrong("a journal with the session_id of another", _of_another, "has the same session_id as"),
    Wrong(
        "a journal copied to another participant", _moved(lambda _, s: s.journal(2), keep=True), "participant 01, task"
    ),
    Wrong("a journal copied to another task", _moved(_other_task, keep=True), "participant 01, task"),
    Wrong("a journal renamed to another task", _moved(_other_task, keep=False), "participant 01, task"),
    Wrong(
        "a journal copied beside itself",
        _moved(lambda p, _: p.with_stem(f"{p.stem} (copy)"), keep=True),
        "looks like a journal",
    ),
    Wrong(
        "a journal moved to another folder",
        _moved(lambda p, _: p.parent.with_name("sub-03") / p.name, keep=False),
        "participant 01, task",
    ),
    Wrong("a folder of another study", _from(study="other"), "study other; allowed: okamoto2012"),
    Wrong("a folder of a study with another seed", _from(seed=5), "seed 5; allowed: 1"),
    Wrong("a folder of a study with another protocol", _from(min_s=170), "protocol_sha256"),
    Wrong("a folder of the study's pilot", _from(pilot=True), "purpose PILOT; allowed: STUDY"),
    Wrong("a folder of the same study, begun again", _from(), "is missing a line that a session depends on"),
    Wrong("a whole dataset in the dataset", _whole("pilot"), "looks like a journal"),
    Wrong("a whole dataset among the sources", _whole("sourcedata/pilot"), "looks like a journal"),
    Wrong(
        "another protocol's copy", _replaced(_protocol, b"min_s = 180", b"min_s = 170"), "changed after it was approved"
    ),
    Wrong("no seal", _gone(_seal), "no seal"),
    Wrong("another seal", _replaced(_seal, b'protocol_sha256 = "', b'protocol_sha256 = "0'), "protocol_sha256"),
    Wrong("another seed in its file", _replaced(_seed, b'"seed": 1', b'"seed": 2'), "is not the seed that was drawn"),
    Wrong("another seed in its file, without its salt", _reseeded, "seed 1; allowed: 2"),
    Wrong("another purpose in its file", _replaced(_seed, b"STUDY", b"PILOT"), "purpose STUDY; allowed: PILOT"),
    Wrong("no seed", _gone(_seed), "the seed and purpose of the study cannot be read"),
    Wrong("no roster", _gone(_roster), "roster.jsonl: the file is missing"),
    Wrong("no roster and no head of it", _gone(_roster, _head(_roster)), "is missing a line that a session depends on"),
    Wrong("a roster written anew", _written_anew, "is missing a line that a session depends on"),
    Wrong("a roster written anew, without the seed's hash", _written_anew_without_the_hash, "has no hash of the seed"),
    Wrong("a roster that forgot a withdrawal", _forgotten("01"), "but not according to the roster"),
    Wrong("a roster that forgot a withdrawal without a session", _forgotten(THIRD), "but not according to the roster"),
    Wrong("a consent after the session", _consent_later, "the session should not have begun: .* 2001-09-20"),
    Wrong("a consent before the approval", _consent_before_approval, "have begun: .* allowed: from 2001-01-01"),
    Wrong("a journal deleted", _gone(MadeStudy.journal), "the file is missing"),
    Wrong(
        "a journal deleted with its head",
        _gone(_head(MadeStudy.journal), MadeStudy.journal),
        "the journal for these frames is missing",
    ),
    Wrong("a journal emptied, its head and tables deleted", _emptied, "records no attempt"),
    Wrong("a session erased but for its frames", _erased, "the journal for these frames is missing"),
    Wrong(
        "a session erased but for its participant's row",
        _without_folders,
        "is missing, although participants.tsv lists",
    ),
    Wrong(
        "a session erased but for its anchor",
        _erased_but_for_the_roster,
        "it had 17 lines in the anchor of",
    ),
    Wrong(
        "a participant erased but for their anchor",
        _erased_everywhere,
        "lines is missing that were in the anchor of",
    ),
    Wrong("a trace of no journal", _stray_trace, "this table has no journal"),
    Wrong("a foot trace edited", _replaced(_foot, b"\x00", b"\x01"), "differ from those that the journal records"),
    Wrong("a foot trace deleted", _gone(_foot), "cannot read the foot trace"),
    Wrong("events of no journal", _foreign_events, "this table has no journal"),
    Wrong("an answer edited in the events", _first_cell, "line 2 does not match the journal", mended=True),
    Wrong("a trial left out of the events", _fewer_rows, "line 3 does not match the journal", mended=True),
    Wrong("events deleted", _gone(_events, _sidecar), "is missing; make it again", mended=True),
    Wrong("a participant left out", _replaced(_people, b"sub-01\t", b"sub-99\t"), "line 2 does not", mended=True),
    Wrong("a withdrawal not in the tables yet", _unfinished_withdrawal, "line 2 does not", mended=True),
    Wrong("another label", _replaced(_description, b'"Label": ""', b'"Label": "x"'), "Palpate does not", mended=True),
    Wrong(
        "another list of materials", _replaced(_sidecar, b'"copy paper"', b'"paper"'), "Materials does not", mended=True
    ),
)
"""All of it is refused by name: by `palpate build` unless it mends it, and by every command that reads a dataset."""


def _tables_alone(study: MadeStudy, _: Path) -> None:
    """All journals, the roster, seed and raw frames are gone."""
    shutil.rmtree(study.root / "sourcedata")


def _protocol_left(study: MadeStudy, folder: Path) -> None:
    """Nothing of sourcedata but the sealed protocol."""
    kept = [(path, path.read_bytes()) for path in (_protocol(study), _seal(study))]
    _tables_alone(study, folder)
    _protocol(study).parent.mkdir()
    for path, content in kept:
        path.write_bytes(content)


ALONE: dict[str, Act] = {"sourcedata deleted": _tables_alone, "all but the protocol deleted": _protocol_left}
"""A study's tables are left, and nothing behind them: `palpate verify` and `palpate build` refuse them, and commands
that analyse tables note it on standard error."""
