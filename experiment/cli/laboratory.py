"""The commands of a study: its participants, its sessions, and what is proven of its dataset."""

import gc
import sys
from collections.abc import Mapping
from datetime import date
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

from palpate.experiment.cli import options
from palpate.experiment.cli.options import Json, Participant, ProtocolFile, Seed, StudyFolder, a_day
from palpate.experiment.errors import DatasetError, RosterError
from palpate.experiment.findings import shown
from palpate.experiment.settings.characters import plain, quoted

commands = options.room()
answers = typer.Typer(
    rich_markup_mode=None,
    help="Have a second person listen to spoken answers.",
    epilog="Example: palpate answers review participants/study --by B",
)
commands.add_typer(answers, name="answers")


@answers.callback()
def _answers() -> None:
    """Have a second person listen to spoken answers."""


Dataset = Annotated[Path, typer.Argument(metavar="DATASET", help="Folder of a study's dataset.")]
ConsentOn = Annotated[
    date | None, typer.Option(parser=a_day, metavar="YYYY-MM-DD", help="Date on which consent was given.")
]
Sharing = Annotated[bool | None, typer.Option("--sharing/--no-sharing", help="Whether their data may be shared.")]
Fact = Annotated[
    list[str] | None,
    typer.Option(
        "--fact", metavar="ID=ANSWER", help="An answer to one of the protocol's questions about the participant."
    ),
]


def _check_roster(protocol_file: Path, dataset: Path | None, *, pilot: bool = False) -> None:
    """Return when nothing in the dataset contradicts its roster, to which a line is about to be added."""
    from palpate.experiment.clock import day, wall_ns
    from palpate.experiment.dataset import checks
    from palpate.experiment.protocol import files
    from palpate.experiment.study import enrolment

    last_ns = checks.check_roster(dataset or enrolment.default_root(files.load(protocol_file), pilot=pilot))
    if wall_ns() < last_ns:
        typer.echo(
            f"palpate: this computer's clock ({day(wall_ns())}) is earlier than the roster's last line "
            f"({day(last_ns)}). Either the clock or the roster is wrong; check the clock before you continue",
            err=True,
        )


@commands.command(epilog="Example: palpate enrol study.toml --participant 01 --consent-on 2026-05-04")
def enrol(
    protocol_file: ProtocolFile,
    participant: Participant,
    consent_on: ConsentOn = None,
    dataset: StudyFolder = None,
    seed: Annotated[
        int | None,
        typer.Option(
            "--seed", min=0, max=options.LARGEST_SEED, help="Seed for the study's random draws [default: a random one]."
        ),
    ] = None,
    pilot: Annotated[
        bool,
        typer.Option(
            "--pilot",
            help="Start a pilot dataset, separate from the study's data [default folder: participants/STUDY-pilot].",
        ),
    ] = False,
    sharing: Sharing = None,
    fact: Fact = None,
) -> None:
    """Enroll the next participant of a study.

    Enrolling the first participant creates the dataset and determines whether it is a pilot. Later commands find a
    pilot by --dataset. When all planned participants are enrolled, each further one replaces somebody who withdrew
    before completing, with the same order of tasks.

    Give the answers to the protocol's questions ([[asked.people]]) with --fact, or answer them in the terminal.
    """
    from palpate.experiment.clock import day, wall_ns
    from palpate.experiment.protocol import files
    from palpate.experiment.protocol.approval import sealing
    from palpate.experiment.study import privacy, roster
    from palpate.experiment.study.people import enrolling

    sealing.refuse_unfilled(protocol_file, files.load(protocol_file))
    _check_roster(protocol_file, dataset, pilot=pilot)
    given = _ask_facts(protocol_file, fact or [], {})
    path = enrolling.enrol(protocol_file, participant, consent_on, root=dataset, seed=seed, pilot=pilot)
    typer.echo(f"Participant {participant} is enrolled: {path}")
    if group := roster.Roster.load(path).groups.get(participant):
        typer.echo(f"Their group: {group}.")
    _record_sharing(protocol_file, participant, sharing, path.parent.parent)
    _record_facts(protocol_file, participant, given, path.parent.parent)
    if warning := privacy.readers_warning(path.parent.parent):
        options.say(f"palpate: {warning}", err=True)
    if told := sealing.unsealed(protocol_file, day(wall_ns())):
        options.say(f"palpate: {told}", err=True)


def _ask_facts(protocol_file: Path, fact: list[str], kept: Mapping[str, object]) -> dict[str, str]:
    """Return what was given of what a participant is asked; if nothing was, what is typed of what has no answer yet."""
    from palpate.experiment.protocol import files

    given: dict[str, str] = {}
    for text in fact:
        name, sign, value = text.partition("=")
        if not sign:
            raise RosterError("--fact", f"got {quoted(text)}", allowed="ID=ANSWER, such as age=34")
        given[name.strip()] = value
    protocol = files.load(protocol_file)
    if not given and not getattr(protocol, "asked", None):
        return {}
    from palpate.experiment.study.people import facts

    facts.read(protocol, given)
    if given or not (sys.stdin.isatty() and sys.stdout.isatty()):
        return given
    if known := [f"{name}={value}" for name, value in kept.items() if value is not None]:
        options.say(f"Already recorded (to correct, use --fact): {', '.join(known)}")
    for one in (one for one in facts.facts(protocol) if kept.get(one.id) is None):
        while typed := options.ask(f"{one.question} ({one.allowed}; Enter for no answer) "):
            try:
                one.read(typed)
                given[one.id] = typed
                break
            except ValueError:
                options.say(f"got {quoted(typed)}; allowed: {one.allowed}", err=True)
    return given


def _record_facts(protocol_file: Path, participant: str, given: dict[str, str], root: Path) -> None:
    if not given:
        return
    from palpate.experiment import storage
    from palpate.experiment.dataset import build as datasets
    from palpate.experiment.study.people import facts

    path = facts.record(protocol_file, participant, given, root=root)
    typer.echo(f"The answers of participant {participant} have been recorded: {path}")
    if storage.journals(root):
        datasets.build(root)


@commands.command(epilog="Example: palpate facts study.toml --participant 01 --fact age=34")
def facts(
    protocol_file: ProtocolFile, participant: Participant, fact: Fact = None, dataset: StudyFolder = None
) -> None:
    """Record or correct a participant's answers about themselves.

    The protocol lists the questions ([[asked.people]]). The answers are stored in a separate file for each
    participant and in participants.tsv. The roster stores only a salted hash, and the salt is deleted with the
    file. A withdrawal deletes all of them.
    """
    from palpate.experiment import storage
    from palpate.experiment.study import enrolment
    from palpate.experiment.study.people import facts
    from palpate.experiment.study.roster import Roster

    _check_roster(protocol_file, dataset)
    root = enrolment.study_begun(protocol_file, dataset)
    kept = facts.answers(root, Roster.load(storage.roster_path(root)), participant)
    given = _ask_facts(protocol_file, fact or [], kept)
    if not given:
        raise RosterError("--fact is missing", remedy="give one for each answer", allowed="--fact ID=ANSWER")
    _record_facts(protocol_file, participant, given, root)


def _record_sharing(protocol_file: Path, participant: str, agreed: bool | None, dataset: Path | None) -> None:
    """Record whether a participant's data may be shared, where that is said."""
    from palpate.experiment.study.people import enrolling

    if agreed is None:
        return
    shared_on = enrolling.sharing(protocol_file, participant, agreed, root=dataset)
    typer.echo(f"Participant {participant} {'agrees' if agreed else 'does not agree'} to have their data shared.")
    if shared_on is not None and not agreed:
        typer.echo(f"Their data were shared on {shared_on}. Copies shared then cannot be recalled.")


@commands.command(epilog="Example: palpate consent study.toml --participant 01 --consent-on 2026-05-04")
def consent(
    protocol_file: ProtocolFile,
    participant: Participant,
    consent_on: ConsentOn = None,
    dataset: StudyFolder = None,
    correct: Annotated[
        bool, typer.Option("--correct", help="Correct the recorded date; the roster still shows the earlier one.")
    ] = False,
    reason: Annotated[
        str | None, typer.Option("--reason", help="Reason for the correction: one line without names.")
    ] = None,
    voices: Annotated[
        bool | None,
        typer.Option("--voices/--no-voices", help="Whether recordings of their spoken answers may be stored."),
    ] = None,
    sharing: Sharing = None,
) -> None:
    """Record the consent of an enrolled participant.

    It covers the version in PROTOCOL. Participants can sign the text of a recorded amendment before its first day.

    With --correct and --reason, a new date replaces the recorded one, which remains in the roster. In a study that
    records spoken answers, --voices records that a participant agrees to this, and --no-voices that they do not;
    any stored recordings are then deleted. Delete copies and backups by hand. In a study that shares data,
    --sharing records that a participant agrees to this, and --no-sharing that they do not.
    """
    from palpate.experiment.study import enrolment

    if correct != (reason is not None):
        raise RosterError(
            "got only one of --correct and --reason",
            remedy="give a reason for the correction",
            allowed="both or neither",
        )
    if consent_on is None and voices is None and sharing is None:
        raise RosterError(
            "got nothing to record", remedy="give one of them", allowed="the date, --[no-]voices or --[no-]sharing"
        )
    _check_roster(protocol_file, dataset)
    if voices is not None:
        path = enrolment.voices(protocol_file, participant, voices, root=dataset)
        agreed = "agrees" if voices else "does not agree"
        typer.echo(f"Participant {participant} {agreed} to have their spoken answers recorded: {path}")
    _record_sharing(protocol_file, participant, sharing, dataset)
    if consent_on is None:
        return
    path = enrolment.consent(protocol_file, participant, consent_on, root=dataset, correction=reason)
    done = "has consented" if reason is None else f"consented on {consent_on}, as corrected"
    typer.echo(f"Participant {participant} {done}: {path}")


@commands.command(epilog="Example: palpate person study.toml -p 01")
def person(
    protocol_file: ProtocolFile,
    participant: Participant,
    show: Annotated[bool, typer.Option("--show", help="Show the stored name and contact.")] = False,
    forget: Annotated[bool, typer.Option("--forget", help="Delete the stored name and contact.")] = False,
    dataset: StudyFolder = None,
) -> None:
    """Store a participant's name outside all datasets.

    A study needs no names. If a lab wants them, they are stored in one file that only you may read. No dataset,
    journal or table contains any. Type the name when asked, so that it does not appear in the process list or the
    shell history. `palpate run` uses the name to ask who is present, and `palpate withdraw` deletes it.
    """
    from palpate.experiment.protocol import files
    from palpate.experiment.study import enrolment, people
    from palpate.experiment.study.people import keeping

    protocol = files.load(protocol_file)
    root = dataset or enrolment.default_root(protocol)
    old = people.known(protocol, root).get(participant, people.Person())
    if forget and show:
        raise RosterError("got --forget with --show", allowed="one of them")
    if forget:
        known = keeping.forget(protocol, root, participant)
        typer.echo(
            f"Participant {participant}: {'name and contact have been deleted' if known else 'nothing was stored'}."
        )
        _tell_other_names(protocol_file, root, known)
    elif show:
        known = old != people.Person()
        told = f"{old.name or 'no name'}, {old.contact or 'no contact'}" if known else "nothing is stored"
        typer.echo(f"Participant {participant}: {told}")
        _tell_other_names(protocol_file, root, known)
    else:
        name = options.ask("Their name (leave it empty to change nothing): ") or old.name
        contact = (
            options.ask("Their contact, such as a phone number (leave it empty to change nothing): ") or old.contact
        )
        try:
            new = people.Person(name=name, contact=contact)
        except ValueError:
            raise RosterError(
                "the name or the contact is not a single line of text", allowed="one line of visible text"
            ) from None
        if new == people.Person():
            raise RosterError(
                "got neither a name nor a contact", remedy="nothing was stored", allowed="one or both of them"
            )
        typer.echo(f"Participant {participant} is stored in {keeping.keep(protocol, root, participant, new)}")


def _tell_other_names(protocol_file: Path, root: Path, known: bool) -> None:
    """Tell where a participant's name may stand, unless it was `known` in the dataset's own file."""
    from palpate.experiment.protocol import files
    from palpate.experiment.study import people
    from palpate.experiment.study.people import keeping

    if known:
        return
    typer.echo(f"{people.folder()} does not contain a name for this participant in the dataset {root}.")
    if others := keeping.others(files.load(protocol_file), root):
        typer.echo("Look in the study's other name files, and delete the name there by hand:")
    for path in others:
        typer.echo(f"  {path}")


@commands.command(epilog="Example: palpate schedule okamoto2012 --participant 03 --seed 1")
def schedule(
    protocol_file: ProtocolFile,
    participant: Participant,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, max=options.LARGEST_SEED, help="Seed for an example [default: 1].")
    ] = None,
    dataset: StudyFolder = None,
    reveal: Annotated[
        bool, typer.Option("--reveal", help="Show the concealed order; the roster records that you looked.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Print the trials of one participant, in order.

    Once somebody is enrolled, this is the study's real order, and each task is concealed until its session has
    begun. Before that, it is an example with a different seed.
    """
    from palpate.experiment import storage
    from palpate.experiment.clock import day, wall_ns
    from palpate.experiment.dataset import checks
    from palpate.experiment.protocol import files
    from palpate.experiment.records import journal
    from palpate.experiment.study import enrolment, roster
    from palpate.experiment.study import schedule as schedules
    from palpate.experiment.study.schedule import allocated, find_allocation

    protocol = files.load(protocol_file)
    root = dataset or enrolment.default_root(protocol)
    own = storage.seed_path(root).exists()
    if own and seed is not None:
        raise RosterError(f"got --seed, but the study in {root} has its own seed", remedy="leave out --seed")
    if not own and (dataset or reveal):
        raise RosterError(
            root, "does not contain a study's seed, so nothing is concealed", "leave out --dataset and --reveal"
        )
    drawn = enrolment.seed_for(root, protocol_file, protocol, None, None) if own else 1 if seed is None else seed
    known = roster.Roster.load(storage.roster_path(root)) if own else roster.Roster(root)
    allocation = find_allocation(allocated(protocol, drawn, known.takes), participant)
    shown = [
        not own or bool(journal.read_if_begun(storage.journal_path(root, participant, task)).lines)
        for task in allocation.tasks
    ]
    if reveal and not all(shown):
        checks.check_roster(root)
        known.append(roster.Revealed, participant=participant, revealed_on=day(wall_ns()))
        shown = [True] * len(shown)
    orders = [
        (task, schedules.schedule(protocol=protocol, participant=participant, task_id=task, seed=drawn))
        if seen
        else None
        for task, seen in zip(allocation.tasks, shown, strict=True)
    ]
    if as_json:
        tasks = [one and {"task": one[0], "order": [trial.model_dump() for trial in one[1]]} for one in orders]
        options.put({"participant": participant, "seed": None if own else drawn, "example": not own, "tasks": tasks})
        return
    for position, one in enumerate(orders, start=1):
        told = one[0] if one else "concealed until the session begins (--reveal shows it, and the roster records that)"
        example = "" if own else f" (an example with seed {drawn}, not the study's order)"
        typer.echo(f"Participant {participant}, task {position}: {told}{example}")
        for planned in one[1] if one else ():
            typer.echo(f"{planned.trial:4d}  {' and '.join(planned.presented)}")


@commands.command(epilog="Example: palpate rehearse okamoto2012 --participants 3 --seed 7 --out trial-run")
def rehearse(
    protocol_file: Annotated[
        Path | None,
        typer.Argument(
            parser=options.a_protocol, metavar="[PROTOCOL]", help="Protocol file [default: the shipped footstep study]."
        ),
    ] = None,
    participants: Annotated[
        int | None, typer.Option("--participants", min=1, help="Number of participants [default: all in the study].")
    ] = None,
    seed: Seed = 1,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of the dataset [default: participants/rehearsal-...].")
    ] = None,
    rig: Annotated[
        Path | None,
        options.file_option("--rig", "A simulated rig [default: the shipped one]."),
    ] = None,
    panel: Annotated[
        Path | None,
        options.file_option("--panel", "Modes file for a simulated panel [default: a panel without phase shift]."),
    ] = None,
    control: Annotated[
        Literal["none", "silence", "heard"],
        typer.Option(
            "--control",
            help="'silence' replaces every stimulus with zeros; with 'heard', participants in a control task recognize "
            "stimuli by their sound.",
        ),
    ] = "none",
    jobs: Annotated[
        int, typer.Option("--jobs", min=0, help="Number of participants to simulate at a time; 0 means one per core.")
    ] = 0,
    real_time: Annotated[bool, typer.Option("--real-time", help="Run in real time, and show each trial.")] = False,
    as_json: Json = False,
) -> None:
    """Run a whole study with simulated participants.

    In a REHEARSAL, a simulated foot is measured through a real serial port, and a simulated observer judges the
    signal sent to the actuator; or a simulated participant taps and compares simulated surfaces. The answers go
    into the journal. The tables are made from the dataset on disk, with figures for the report; `palpate analyse`
    also draws them as PNG. To continue an interrupted rehearsal, run the same command again.
    """
    if not as_json:
        options.at_once("REHEARSAL: setting up the simulated laboratory ...")
    from palpate.experiment.protocol import files

    file = protocol_file or files.shipped("okamoto2012.toml")
    protocol = files.load(file)
    at_once = jobs != 1 and not real_time
    from palpate.experiment.cli.analysis.analyst import analyst
    from palpate.experiment.desk.interrupts import deferred

    with analyst(elsewhere=at_once, as_json=as_json) as analyse:
        # An import calls back, and what interrupts it there is lost.
        with deferred():
            from palpate.experiment.desk.terminal import TerminalConsole
            from palpate.experiment.rehearsal import study

            generic = study.generic(protocol)
        if at_once:
            # No process has to search what all of them share.
            gc.freeze()
        if generic and not as_json:
            typer.echo(generic, err=True)
        shown = real_time and not as_json
        screen = TerminalConsole(write=sys.stderr, ask=input, heading="REHEARSAL") if shown else None
        with options.progress("REHEARSAL", quiet=as_json or shown) as (total, tick):
            dataset = study.rehearse(
                protocol_file=file,
                rig_file=rig or study.simulated_rig(protocol),
                out=out,
                participants=participants,
                seed=seed,
                panel_file=panel,
                control=control,
                real_time=real_time,
                jobs=jobs,
                total=total,
                tick=tick,
                screen=screen,
            )
        options.put(analyse(dataset))


@commands.command(
    epilog="Example: palpate journal participants/study/sourcedata/sub-01/sub-01_task-virtual_journal.jsonl"
)
def journal(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Journal of a session (.jsonl).")],
    trial: Annotated[int | None, typer.Option("--trial", min=1, help="Print only this trial.")] = None,
    as_json: Json = False,
) -> None:
    """Verify a journal and print it as text.

    The command reports unreadable entries and prints the rest; the exit code is then 1.
    """
    from palpate.experiment.records import journal as journals
    from palpate.experiment.records import transcript

    contents = journals.read(file, strict=False)
    if as_json:
        entries = [
            {"t_ns": line.t_ns, **line.entry.model_dump(mode="json")}
            for line in contents.lines
            if trial is None or getattr(line.entry, "trial", None) == trial
        ]
        unreadable = [{"line": one.number, "t_ns": one.t_ns, "why": one.why} for one in contents.unreadable]
        torn = len(contents.torn)
        options.put({"file": str(file), "torn_bytes": torn, "entries": entries, "unreadable": unreadable})
    else:
        typer.echo(transcript.text(contents, trial))
    if contents.unreadable:
        raise typer.Exit(1)


@commands.command(epilog="Example: palpate withdraw study.toml --participant 01 --reason 'asked to stop'")
def withdraw(
    protocol_file: ProtocolFile,
    participant: Participant,
    reason: Annotated[str, typer.Option("--reason", help="One line of text, without names or health information.")],
    erase: Annotated[bool, typer.Option("--erase", help="Also delete the participant's data permanently.")] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="Erase without asking for confirmation, e.g., in a script.")
    ] = False,
    dataset: StudyFolder = None,
) -> None:
    """Record that a participant withdrew.

    Their journals record it too, their data are not analyzed, and their answers about themselves are deleted. With
    --erase, their journals, raw frames and tables are deleted, after you type their label again. The roster retains
    the label, the consent, the withdrawal, and the fact that the data were erased. To finish an interrupted
    withdrawal, run the same command again. The dataset stores an anchor.
    """
    from palpate.experiment.dataset import build as datasets
    from palpate.experiment.dataset import checks
    from palpate.experiment.protocol import files
    from palpate.experiment.protocol.blocks import count
    from palpate.experiment.study import enrolment, withdrawal
    from palpate.experiment.study.people import keeping

    if yes and not erase:
        raise RosterError("got --yes without --erase", remedy="use --yes only with --erase", allowed="both, or neither")
    _check_roster(protocol_file, dataset)
    if erase and not yes:
        sessions, answers, others = withdrawal.count_recorded(protocol_file, participant, root=dataset)
        what = f"{count(sessions, 'session')} with participant {participant} and {count(answers, 'answer')}"
        if not sessions:
            what = f"the remaining data of participant {participant}, who has no session here"
        if others:
            what += f" (including {count(others, 'session')} with others who withdrew, recorded under this label)"
        options.confirm(f"This permanently deletes {what}.", participant, "nothing was erased")
    try:
        path = withdrawal.withdraw(
            protocol_file, participant, reason, root=dataset, rebuild=datasets.build, erase=erase
        )
    except DatasetError:
        # The data are gone all the same where only the tables could not be made again.
        if erase:
            _tell_unknown_files(dataset or enrolment.default_root(files.load(protocol_file)), participant)
        raise
    typer.echo(f"Participant {participant} has withdrawn{' and their data have been erased' if erase else ''}: {path}")
    root = path.parent.parent
    if known := keeping.forget(files.load(protocol_file), root, participant):
        typer.echo("Their name has been deleted from the name file.")
    _tell_other_names(protocol_file, root, known)
    if erase:
        typer.echo(
            f"{path.parent} still contains their label, the date of consent, and the withdrawal with its reason.\n"
            "Their data also remain in backups, copies, and the tables of earlier analyses and exports (such as those "
            "in derivatives): delete those, or make the tables again."
        )
        _tell_unknown_files(root, participant)
    else:
        typer.echo(
            "Their data remain but are not analyzed. To delete them permanently, add --erase to the same command."
        )
    typer.echo(
        f"For the lab book: {checks.keep_anchor(root)[0].line}\nTo enter it in the register as well: "
        f"{shown(('palpate', 'anchor', str(root), '--to', 'REGISTER'))}."
    )


def _tell_unknown_files(root: Path, participant: str) -> None:
    """Tell which files beside those of palpate may hold data of a participant whose own files are gone."""
    from palpate.experiment import storage
    from palpate.experiment.study import privacy

    unknown = () if storage.left_of(root, participant) else privacy.unknown_files(root)
    if unknown:
        typer.echo(f"palpate does not recognize these files in {root}. Delete all that contain data of {participant}:")
    for name in unknown:
        typer.echo(f"  {plain(name)}")


@commands.command(epilog="Example: palpate build participants/study")
def build(dataset: Dataset) -> None:
    """Rebuild a dataset's tables from its journals."""
    from palpate.experiment.dataset import build as datasets
    from palpate.experiment.dataset.checks import findings

    for lost in findings(datasets.build(dataset), "losses"):
        typer.echo(f"{lost.sentence()}.")
    typer.echo(f"Dataset: {dataset}")


@commands.command(epilog="Example: palpate anchor participants/study --to /mnt/register.jsonl --sign lab_key")
def anchor(
    dataset: Dataset,
    to: Annotated[
        Path | None, typer.Option("--to", help="The register: a file on a different disk or a shared drive.")
    ] = None,
    key: Annotated[
        Path | None, typer.Option("--sign", help="Private SSH key that signs the anchor in the register.")
    ] = None,
) -> None:
    """Anchor a dataset in a register outside it.

    An anchor consists of the number of lines in the roster and in each journal, and the hash of the last line.
    Without options, it is stored only in the dataset; write its number in the lab book. `palpate run` does the same
    at the end of each session, with the register that the rig file names.
    """
    from palpate.experiment.dataset import checks, register
    from palpate.experiment.errors import DatasetError

    if key and not to:
        raise DatasetError("got --sign without --to", remedy="add the register", allowed="both, or only --to")
    made, _ = checks.keep_anchor(dataset)
    entered = f"\n{register.enter(made, dataset, to, key)}" if to else ""
    typer.echo(f"For the lab book: {made.line}{entered}")


@commands.command(
    epilog="Example: palpate verify participants/study --register /mnt/register.jsonl --signer lab_key.pub"
)
def verify(
    dataset: Dataset,
    registers: Annotated[
        list[Path] | None,
        typer.Option("--register", metavar="FILE", help="A register outside the dataset; may be repeated."),
    ] = None,
    numbers: Annotated[
        list[str] | None,
        typer.Option("--number", metavar="NUMBER", help="An anchor number from the lab book; may be repeated."),
    ] = None,
    signer: Annotated[
        Path | None, typer.Option("--signer", help="Public SSH key (.pub); only anchors signed with it count.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Show what a dataset proves and what it does not.

    Each finding is printed as valid or as REFUSED. This command changes no files. The exit code is 1 if anything is
    refused, and 2 if nothing could be checked, for example because a register is missing.
    """
    from palpate.experiment.dataset import verify as verifying
    from palpate.experiment.dataset.outside.signatures import Signer
    from palpate.experiment.settings.characters import plain

    report = verifying.verify(dataset, registers or (), numbers or (), Signer(signer) if signer else None)
    if as_json:
        options.put({"title": report.title, "findings": report.records(), "verdict": list(report.verdict)})
    else:
        words = {"passes": "holds", "refuses": "REFUSED"}
        found = [f"  {words.get(one.verdict, 'note'):7}  {one.sentence()}" for one in report.findings]
        # A name of a file may hold line feeds, and passes for no line of the report.
        typer.echo("\n".join(plain(line, keep="") for line in (report.title, *found, *report.verdict)))
    raise typer.Exit(1 if report.refused else 0)


@answers.command("review", epilog="Example: palpate answers review participants/study --by B --player aplay")
def review(
    dataset: Dataset,
    by: Annotated[
        str, typer.Option("--by", metavar="LABEL", help="Who listens: a label for the record, not a name.")
    ] = "B",
    share: Annotated[
        float, typer.Option("--share", min=0, max=1, help="Proportion of the unflagged answers to listen to.")
    ] = 0.1,
    seed: Seed = 1,
    player: Annotated[
        str | None,
        typer.Option(
            "--player", metavar="COMMAND", help="Command that plays a WAV file [default: this computer's sound output]."
        ),
    ] = None,
    paths: Annotated[
        bool, typer.Option("--paths", help="Print the path of each recording instead of playing it.")
    ] = False,
    only_list: Annotated[
        bool, typer.Option("--list", help="Print the paths of the answers still to review, then exit.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Ask nothing; print the agreement between the two listeners as JSON.")
    ] = False,
) -> None:
    """Have a second person listen to spoken answers, and report the agreement.

    The command plays, in random order, the answers whose key and proposal differ, those with no or only a weak
    proposal, and a share of the others. It does not show what was presented, keyed or proposed. The second rater's
    answers are stored next to the sounds; the first answers do not change. To continue later, run the same command
    again. Cohen's kappa is reported for the random share and, separately, for the flagged answers.
    """
    from palpate.experiment.desk.voice import review as reviews

    review = reviews.read_review(dataset, by=by, share=share, seed=seed)
    if only_list:
        for one in review.left:
            typer.echo(str(one.file))
        return
    if not as_json:
        play = None if paths else partial(reviews.play, player=player)
        review = review.continued(play, tell=typer.echo, ask=_typed)
    options.put(review.as_dict() if as_json else review.text())


def _typed(offered: str) -> str | None:
    """Return the key that somebody types when these are offered; None where nothing more can be typed."""
    try:
        return input(f"{offered}\nKey: ").strip().lower()
    except EOFError:
        typer.echo()
        return None
