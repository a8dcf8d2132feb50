"""The commands of a study with participants in the room: seal, enrol, consent, withdraw, run, build."""

import sys
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

lab = typer.Typer()

DAY = ["%Y-%m-%d"]

ProtocolFile = Annotated[Path, typer.Argument(metavar="PROTOCOL", help="Protocol file (TOML).")]
Participant = Annotated[str, typer.Option("--participant", "-p", help="Label of the participant, such as 03.")]
StudyFolder = Annotated[
    Path | None, typer.Option("--dataset", help="Folder of the study's dataset; participants/STUDY by default.")
]


@lab.command(
    epilog="Example: palpate seal study.toml --approval-number 2026-17 --approved-on 2026-04-01 --expires-on 2027-03-31"
)
def seal(
    protocol_file: ProtocolFile,
    approval_number: Annotated[str, typer.Option("--approval-number", help="As on the board's letter.")],
    approved_on: Annotated[
        datetime, typer.Option(formats=DAY, metavar="YYYY-MM-DD", help="First day on which the study may run.")
    ],
    expires_on: Annotated[datetime, typer.Option(formats=DAY, metavar="YYYY-MM-DD", help="Last day on which it may.")],
    replace: Annotated[bool, typer.Option("--replace", help="Of an earlier form of the protocol.")] = False,
) -> None:
    """Record the board's approval of a protocol.

    Writes STUDY.seal.toml beside the protocol, with the SHA-256 of what was approved. `palpate run` refuses a
    protocol that is not sealed, was changed since, or whose approval has expired.
    """
    from experiment.protocol import approval, files

    protocol = files.load(protocol_file)
    sealed = approval.write(
        protocol_file,
        protocol,
        approval_number=approval_number,
        board=protocol.ethics.board,
        approved_on=approved_on.date(),
        expires_on=expires_on.date(),
        replace=replace,
    )
    typer.echo(f"Sealed {sealed.protocol_sha256}: {approval.seal_path(protocol_file)}")


@lab.command(epilog="Example: palpate enrol study.toml --participant 01 --consent-on 2026-05-04")
def enrol(
    protocol_file: ProtocolFile,
    participant: Participant,
    consent_on: Annotated[
        datetime | None, typer.Option(formats=DAY, metavar="YYYY-MM-DD", help="Day of consent.")
    ] = None,
    dataset: StudyFolder = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="Of the study; drawn if left out.")] = None,
) -> None:
    """Enrol the next participant of a study."""
    from experiment.study import enrolment

    path = enrolment.enrol(
        protocol_file, participant, consent_on.date() if consent_on else None, root=dataset, seed=seed
    )
    typer.echo(
        f"Participant {participant} is enrolled: {path}\nSeed of the study: {enrolment.seed_of(path.parents[1])}"
    )


@lab.command(epilog="Example: palpate consent study.toml --participant 01 --consent-on 2026-05-04")
def consent(
    protocol_file: ProtocolFile,
    participant: Participant,
    consent_on: Annotated[datetime, typer.Option(formats=DAY, metavar="YYYY-MM-DD", help="Day of consent.")],
    dataset: StudyFolder = None,
) -> None:
    """Record the consent of an enrolled participant."""
    from experiment.study import enrolment

    path = enrolment.consent(protocol_file, participant, consent_on.date(), root=dataset)
    typer.echo(f"Participant {participant} has consented: {path}")


@lab.command(epilog="Example: palpate withdraw study.toml --participant 01 --reason 'asked to stop'")
def withdraw(
    protocol_file: ProtocolFile,
    participant: Participant,
    reason: Annotated[str, typer.Option("--reason", help="One line that names no person and no state of health.")],
    dataset: StudyFolder = None,
) -> None:
    """Record that a participant withdrew."""
    from experiment.dataset import build as datasets
    from experiment.study import enrolment

    path = enrolment.withdraw(protocol_file, participant, reason, root=dataset, rebuild=datasets.build)
    typer.echo(f"Participant {participant} has withdrawn: {path}")


@lab.command(epilog="Example: palpate run study.toml --participant 01 --task real --rig our-rig.toml")
def run(
    protocol_file: ProtocolFile,
    participant: Participant,
    task: Annotated[str, typer.Option("--task", help="One of the participant's tasks.")],
    rig: Annotated[Path, typer.Option("--rig", help="Rig file of this laboratory.")],
    recordings: Annotated[
        Path | None, typer.Option("--recordings", help="Folder of recordings; stimuli/recordings in the dataset.")
    ] = None,
    dataset: StudyFolder = None,
) -> None:
    """Run one session with a participant, or what remains of it.

    The protocol must be sealed and the participant enrolled. Ctrl-C pauses; the same command goes on. Where the rig
    file has the tracker zeroed, the participant's foot first rests on the panel.
    """
    from experiment.desk.terminal import TerminalConsole
    from experiment.session import run as study

    console = TerminalConsole(write=sys.stdout, ask=input, heading=f"Participant {participant}, task {task}.")
    footer = study.run(
        protocol_file=protocol_file,
        rig_file=rig,
        participant=participant,
        task_id=task,
        root=dataset,
        recordings=recordings,
        console=console,
    )
    typer.echo(f"The session is {footer.reason}: {footer.answered} answers. {footer.detail}".rstrip())


@lab.command(epilog="Example: palpate build participants/study")
def build(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Folder of a study's dataset.")],
) -> None:
    """Make a dataset's tables anew from its journals."""
    from experiment.dataset import build as datasets

    datasets.build(dataset)
    typer.echo(f"Dataset: {dataset}")
