"""The commands of a protocol: writing one, the page that its board reads, and its approval."""

import re
from collections.abc import Callable
from dataclasses import replace
from datetime import date
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

import typer

from palpate.experiment.cli import options
from palpate.experiment.cli.options import Json, ProtocolFile, a_day, a_protocol
from palpate.experiment.errors import Interrupted, PalpateError
from palpate.experiment.findings import shown
from palpate.experiment.settings.characters import quoted

if TYPE_CHECKING:
    from palpate.experiment.apparatus.rig import Rig
    from palpate.experiment.findings import Finding
    from palpate.experiment.protocol.models import Protocol
    from palpate.experiment.protocol.new import NewStudy
    from palpate.experiment.protocol.new.models import Changes

commands = options.room()

Taken = TypeVar("Taken")


@commands.command(epilog="Example: palpate new mystudy.toml --material 'felt, f, felt, cloth' --material cork")
def new(
    protocol_file: Annotated[
        Path | None, typer.Argument(metavar="[PROTOCOL.toml]", help="New file [default: ID.toml].")
    ] = None,
    like: Annotated[
        Path | None,
        typer.Option("--like", parser=a_protocol, metavar="PROTOCOL", help="Copy this protocol, such as okamoto2012."),
    ] = None,
    kind: Annotated[
        Literal["footstep", "presented", "tapping"] | None,
        typer.Option("--kind", help="Kind of trial [default: footstep]; for other kinds, a shipped study is copied."),
    ] = None,
    design: Annotated[
        Literal["identification", "detection", "comparison", "rating"] | None,
        typer.Option("--design", help="What trials of that kind ask [default: the kind's first design]."),
    ] = None,
    answers: Annotated[
        Literal["oral", "keys", "screen"] | None,
        typer.Option("--answers", help="How participants of a copy answer: aloud, at buttons, or at their screen."),
    ] = None,
    recordings: Annotated[
        list[Path] | None,
        typer.Option(
            "--recording",
            metavar="FILE.wav",
            help="A recorded waveform to identify; may be given several times.",
        ),
    ] = None,
    full_scale: Annotated[
        float, typer.Option("--full-scale", help="Acceleration of the recordings at full scale, m/s^2.")
    ] = 10.0,
    factors: Annotated[
        list[str] | None,
        typer.Option(
            "--factor",
            metavar="ID=NUMBER,NUMBER,...",
            help="Values of a factor in a copied study; may be given several times.",
        ),
    ] = None,
    study_id: Annotated[
        str | None, typer.Option("--id", help="Id of the study: up to 32 lowercase letters and digits.")
    ] = None,
    title: Annotated[str | None, typer.Option("--title", help="Title of the study.")] = None,
    participants: Annotated[int | None, typer.Option("--participants", help="Number of participants.")] = None,
    materials: Annotated[
        list[str] | None,
        typer.Option(
            "--material",
            metavar="NAME[,KEY,PHRASE,...]",
            help="A material, its key, and the words that participants may say; may be given several times.",
        ),
    ] = None,
    tasks: Annotated[
        Literal["virtual", "real", "both"] | None, typer.Option("--tasks", help="Vibration, real objects, or both.")
    ] = None,
    repetitions: Annotated[
        int | None, typer.Option("--repetitions", help="Number of times that a task presents each material.")
    ] = None,
    training: Annotated[
        int | None,
        typer.Option(
            "--training", help="Begin each task with this many training trials, with feedback; they never count."
        ),
    ] = None,
    control: Annotated[
        bool,
        typer.Option(
            "--control",
            help="Add a task that tests the masking: the panel makes its sound, but the foot feels nothing.",
        ),
    ] = False,
    rig: Annotated[
        Path | None, typer.Option("--rig", help="Also write a starter rig file; without a protocol, only that.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Ask nothing, and use defaults for everything else.")] = False,
) -> None:
    """Write a new protocol, with a comment for every key.

    The command asks a few questions; press Enter to accept a default. Fields that only your laboratory can complete
    are marked TO BE FILLED IN. You can practice and rehearse the study at once. With --like, or a --kind or
    --design that is not the default, a study is copied under a new id, without its approval; each --recording of an
    identification is copied too. No file is overwritten.
    """
    ask = not yes
    study = (protocol_file, like, kind, design, answers, recordings, study_id, title, participants, materials, tasks)
    if rig and not any((*study, repetitions, control)):
        _write_rig(free_for_a_rig(rig))
        return
    if ask:
        options.at_once(
            "A new protocol. Press Enter to accept an answer in brackets. Ctrl-C stops without writing anything."
        )
    from palpate.experiment.protocol import new as writing
    from palpate.experiment.protocol.new import models

    file = protocol_file and writing.free(protocol_file)
    rig = rig and free_for_a_rig(rig)

    def named(typed: str) -> str:
        writing.checked(writing.NewStudy(id=typed))
        if file is None:
            writing.free(Path(typed))
        return typed

    stem = re.sub("[^a-z0-9]", "", file.stem.lower()) if file else ""
    default = stem if re.match("[a-z]", stem) else writing.NewStudy.id
    study_id = _answered("Id of the study, used in file names", default, study_id, ask, named)
    like = _model(like, kind, design, ask)
    changed = models.Changes(
        participants, answers, models.recordings(recordings or ()), full_scale, models.values(factors)
    )
    if like:
        text = _a_copy(like, study_id, title, changed, ask, of_questions=(materials, tasks, repetitions))
    elif answers or recordings or factors:
        got, allowed = (
            "got --answers, --recording or --factor for a footstep study",
            "a copy: --like, or --kind presented",
        )
        raise PalpateError(got, remedy="leave them out", allowed=allowed)
    else:
        given = [None if one is None else str(one) for one in (participants, repetitions)]
        text = writing.text(_new_study(writing.NewStudy(id=study_id), title, given, materials, tasks, ask))
    text = text if training is None else writing.trained(text, training)
    text = writing.controlled(text) if control else text
    file = file or writing.free(Path(study_id))
    if rig is None:
        asks = "Name of a starter rig file, or Enter for none"
        rig = _answered(asks, "", None, ask, lambda typed: free_for_a_rig(Path(typed)) if typed else None)
    _write_new(file, rig, text, changed)


CALIBRATE = "Rig: {rig}. Next, calibrate it (see `palpate docs rigs`)."
"""What may follow a new rig file."""


def _write_rig(rig: Path) -> None:
    """Write a new rig alone."""
    from palpate.experiment import storage

    storage.write(rig, a_rig(rig).encode())
    typer.echo(CALIBRATE.format(rig=rig))


def _write_new(file: Path, rig: Path | None, text: str, changed: "Changes") -> None:
    """Write a new protocol, its recordings and its rig, or nothing, and say what may follow."""
    from palpate.experiment import storage
    from palpate.experiment.protocol.new import models

    if rig and rig.resolve() == file.resolve():
        raise PalpateError(
            f"got {quoted(str(file))} for both protocol and rig", remedy="name another", allowed="a file for each"
        )
    made = models.files_beside(file, changed) | {file: text.encode()} | ({rig: a_rig(rig).encode()} if rig else {})
    for path, content in made.items():
        storage.write(path, content)
    typer.echo(f"Protocol: {file}")
    if rig:
        typer.echo(CALIBRATE.format(rig=rig))
    typer.echo(
        f"To practice a session at your own keyboard: {shown(('palpate', 'run', str(file), '--practice'))}\nTo see "
        f"the protocol as an ethics board does: {shown(('palpate', 'check', str(file)))}"
    )


def _model(like: Path | None, kind: str | None, design: str | None, ask: bool) -> Path | None:
    """Return the study that a new one is a copy of, as the options say or is answered, or None."""
    from palpate.experiment.protocol.new import models

    given = " ".join(filter(None, (kind, design))) or None
    if like and given:
        raise PalpateError("got --kind or --design with --like", remedy="leave them out", allowed="one of them")
    asks = "\n  ".join(("Kind of trial and what it asks, one of:", *models.KINDS)) + "\nWhich one"
    return like or _answered(asks, models.KINDS[0], given, ask, models.model)


def _a_copy(
    like: Path, study_id: str, title: str | None, changed: "Changes", ask: bool, of_questions: tuple[object, ...]
) -> str:
    """Return the text of a protocol like another, with what the options say, or what is answered."""
    from palpate.experiment.protocol import files
    from palpate.experiment.protocol import new as writing
    from palpate.experiment.protocol.new import models

    if any(one is not None for one in of_questions):
        got, remedy = "got --material, --tasks or --repetitions with a copy", "edit the copy to change anything else"
        allowed = "--id, --title, --participants, --answers, --recording and --factor"
        raise PalpateError(got, remedy=remedy, allowed=allowed)

    def of_people(typed: str) -> "Changes":
        made = replace(changed, participants=writing.whole(typed, ("study", "participants")))
        models.copied(like, study_id, changed=made)
        return made

    def of_mode(typed: str) -> "Changes":
        made = replace(changed, mode=typed)
        models.copied(like, study_id, changed=made)
        return made

    known, people = files.load(like), changed.participants
    asks = "Number of participants"
    given = None if people is None else str(people)
    changed = _answered(asks, str(known.study.participants), given, ask, of_people)
    changed = _answered("How participants answer: oral, keys or screen", known.answers.mode, changed.mode, ask, of_mode)
    return _answered("Title", known.study.title, title, ask, partial(models.copied, like, study_id, changed=changed))


def _new_study(
    study: "NewStudy",
    title: str | None,
    numbers: list[str | None],
    materials: list[str] | None,
    tasks: str | None,
    ask: bool,
) -> "NewStudy":
    """Return a study with what the options say, or with what is answered; `numbers`: of participants, repetitions."""
    from palpate.experiment.protocol import new as writing

    def answered(
        study: "NewStudy", name: str, asks: str, default: str, given: str | None, read: Callable[[str], object] = str
    ) -> "NewStudy":
        def take(typed: str) -> "NewStudy":
            return writing.checked(replace(study, **{name: read(typed)}))  # type: ignore[arg-type]

        return _answered(asks, default, given, ask, take)

    def whole(*path: str | int) -> Callable[[str], int]:
        return partial(writing.whole, path=path)

    study = answered(study, "title", "Title", study.title, title)
    people, read = "Number of participants", whole("study", "participants")
    study = answered(study, "participants", people, str(study.participants), numbers[0], read)
    if materials:
        study = writing.checked(replace(study, materials=writing.materials(materials)))
    else:
        names = ", ".join(one.name for one in study.materials)
        apart = "Materials to identify, separated by commas"
        study = answered(study, "materials", apart, names, None, lambda t: writing.materials(writing.parts(t)))
        for place, one in enumerate(study.materials):
            asks, default = (
                f"{one.name}: its key, then the words that participants may say",
                study.materials[place].typed,
            )
            study = _answered(asks, default, None, ask, partial(writing.with_material, study, place))
    of = "Tasks: virtual (vibration of the panel), real (the objects) or both"
    study = answered(study, "tasks", of, study.tasks, tasks)
    often, read = "Number of times that a task presents each material", whole("tasks", 0, "repetitions")
    return answered(study, "repetitions", often, str(study.repetitions), numbers[1], read)


def _answered(asks: str, default: str, given: str | None, ask: bool, take: Callable[[str], Taken]) -> Taken:
    """Return what `take` makes of an option, of the default where nothing is asked, or of what is typed.

    What is typed and cannot be taken is told, and asked for again. Raises `PalpateError` for an option.
    """
    if given is not None or not ask:
        return take(default if given is None else given)
    while True:
        typed = _typed(f"{asks} [{' '.join(default.split()) or 'none'}]: ")
        try:
            return take(typed or default)
        except PalpateError as error:
            for one in error.findings:
                typer.echo("\n".join(one.lines(options.columns(10_000), ("  ", ""))))


def _typed(prompt: str) -> str:
    """Return what is typed. Raises `Interrupted` on Ctrl-C, at the input's end, and where nobody can type."""
    try:
        return input(prompt).strip()
    except (KeyboardInterrupt, EOFError, OSError, ValueError, RuntimeError):
        raise Interrupted(
            "interrupted; nothing was written",
            remedy="to answer without typing, use options and add --yes",
        ) from None


def free_for_a_rig(rig: Path) -> Path:
    """Return where a new rig file goes. Raises `PalpateError` as `new.free`, and if its name is none for a rig."""
    import tomllib

    from palpate.experiment.apparatus.rig import Rig
    from palpate.experiment.protocol import new as writing
    from palpate.experiment.settings import load

    path = writing.free(rig)
    load.checked(path, Rig, tomllib.loads(a_rig(path)))
    return path


def a_rig(rig: Path) -> str:
    """Return the text of a new rig file: the shipped one, under the name of its file."""
    from palpate.experiment.protocol.files import shipped
    from palpate.experiment.settings import load

    text = shipped("rigs/laboratory.toml").read_text("utf-8")
    return text.replace('name = "laboratory"', f"name = {load.toml(rig.stem)}", 1)


@commands.command(epilog="Example: palpate check okamoto2012")
def check(
    protocol_file: ProtocolFile,
    page_file: Annotated[
        Path | None,
        typer.Option("--html", metavar="FILE.html", help="Write the page as HTML, for a browser to print on A4."),
    ] = None,
    rig_file: Annotated[
        Path | None,
        typer.Option("--rig", help="Rig file, to check whether the rig can render this study's vibrations or block."),
    ] = None,
    recordings: Annotated[
        Path | None, typer.Option("--recordings", help="Folder of recordings, for --rig [default: the dataset's own].")
    ] = None,
    as_json: Json = False,
) -> None:
    """Show a protocol as its ethics board sees it.

    The page states the whole study. It ends with empty fields, unusual values, and whether this version is sealed,
    by which board and until when. If the file has errors, the command prints all of them instead, each with its
    key, its line, its value and the allowed values. With --html it writes the page to a file, with the SHA-256 and
    the seal on every sheet; print it from a browser, on paper or as PDF. The results of --rig come last.

    With --rig, a rig is refused if it leaves out more of the recorded vibrations than
    footstep.synthesis.left_out_max allows, or if it cannot render a virtual block's stiffness. palpate run also
    refuses it for participants, but not for practice and rehearsals. The page also shows the words of the rig's
    screen that differ from palpate's.
    """
    from palpate.experiment.apparatus import rig as rigs
    from palpate.experiment.clock import day, wall_ns
    from palpate.experiment.errors import ProtocolError
    from palpate.experiment.protocol import approval, blocks, files, page
    from palpate.experiment.protocol.approval import sealing
    from palpate.experiment.protocol.page import rendering

    try:
        protocol = files.load(protocol_file)
        files.companions(protocol)
        doubts = _companion_doubts(protocol_file, protocol)
    except ProtocolError as error:
        if as_json:
            options.put(
                {"file": str(error.finding.where), "valid": False, "errors": [one.record() for one in error.findings]}
            )
            raise typer.Exit(error.exit_code) from None
        raise
    today = day(wall_ns())
    state, seal = sealing.state(protocol_file, protocol, today)
    told, refusal, screen = "", None, None
    if rig_file is not None:
        rig = rigs.load(rig_file)
        told, refusal = _examine_rig(protocol, rig_file, rig, recordings, today)
        screen = rig.screen
    words = screen.words.own if screen is not None and screen.words is not None else {}
    of_screen: list[blocks.Block] = []
    if rig_file is not None and rig.triggers:
        from palpate.experiment.apparatus.wires.triggers import board_words

        told = " ".join(filter(None, (told, board_words(rig))))
    if words:
        said = "This rig changes these words on the participant's screen; the protocol's approval does not cover them:"
        of_screen = [blocks.Said(said), blocks.facts(*((name, blocks.Free(text)) for name, text in words.items()))]
    if page_file is not None:
        if page_file.suffix != ".html":
            raise PalpateError(f"got the file {quoted(str(page_file))}", allowed="a name that ends in .html")
        judged = [blocks.Said(one) for one in (told, "" if refusal is None else str(refusal)) if one]
        options.put_file(
            page_file, page.html(protocol, str(protocol_file), state, seal, today, [*judged, *of_screen]).encode()
        )
    if as_json:
        import json

        sha256, document = approval.sha256(protocol), json.loads(approval.canonical(protocol))
        approved = seal.model_dump(mode="json", exclude={"protocol"}) if seal else None
        known = {"file": str(protocol_file), "valid": True, "sha256": sha256, "seal": state, "approval": approved}
        known["advice"] = [one.record() for one in (*page.advice(protocol), *doubts)]
        if rig_file is not None:
            refused = None if refusal is None else str(refusal)
            known["rig"] = {"file": str(rig_file), "told": told, "refused": refused, "words": words}
        options.put(known | {"protocol": document})
    elif page_file is not None:
        typer.echo(f"{state}\nPage: {page_file}. Open it in a browser to print it on A4 or as PDF.")
    else:
        shown = f"{page.page(protocol, str(protocol_file))}\n{state}"
        typer.echo(f"{shown}\n{page.approved(seal)}" if seal else shown)
    for one in () if as_json else doubts:
        typer.echo(f"\n{one.sentence()}.")
    if told and not as_json:
        typer.echo(f"\n{told}")
    if words and not as_json:
        typer.echo("\n".join(("", *rendering.lines(of_screen))))
    if refusal is not None:
        if as_json:
            raise typer.Exit(refusal.exit_code)
        raise refusal


def _companion_doubts(protocol_file: Path, protocol: "Protocol") -> "list[Finding]":
    """Return what is odd about the files beside a protocol. Raises `ProtocolError` for what cannot be played."""
    from palpate.experiment.errors import ProtocolError
    from palpate.experiment.session.kind import session_kind

    found = list(session_kind(protocol.tasks[0]).companions(protocol))
    if refused := [one for one in found if one.refuses]:
        raise ProtocolError.in_file(protocol_file, refused)
    return found


def _examine_rig(
    protocol: "Protocol", rig_file: Path, rig: "Rig", recordings: Path | None, today: date
) -> tuple[str, PalpateError | None]:
    """Return what the board reads of a rig for a study, and why it is refused for participants `today`, if it is."""
    from palpate.experiment.apparatus.panel.validity import refuse_unmeasured
    from palpate.experiment.session import answering
    from palpate.experiment.session.kind import session_kind

    virtual, said = [task for task in protocol.tasks if task.stimulus == "virtual"], []
    try:
        answering.check(protocol, rig)
    except PalpateError as refused:
        return "", refused
    if not virtual:
        return f"Rig '{rig.rig.name}': every task uses real objects, so it renders nothing.", None
    try:
        for site in protocol.limits_m_s2:
            refuse_unmeasured(rig_file, rig.at(site), today)
        for kind in {session_kind(task): None for task in virtual}:
            told, refusal = kind.examine(protocol=protocol, rig=rig, rig_file=rig_file, recordings=recordings)
            said.append(told)
            if refusal is not None:
                return " ".join(said), refusal
    except PalpateError as refused:
        return "", refused
    return " ".join(said), None


@commands.command(
    epilog="Example: palpate seal study.toml --approval-number 2026-17 --approved-on 2026-04-01 --expires-on 2027-03-31"
)
def seal(
    protocol_file: Annotated[Path, typer.Argument(metavar="PROTOCOL", help="Your own protocol file (TOML).")],
    approval_number: Annotated[str, typer.Option("--approval-number", help="The number on the board's letter.")],
    approved_on: Annotated[
        date, typer.Option(parser=a_day, metavar="YYYY-MM-DD", help="First day on which the study may run.")
    ],
    expires_on: Annotated[
        date, typer.Option(parser=a_day, metavar="YYYY-MM-DD", help="Last day on which the study may run.")
    ],
    sha256: Annotated[
        str | None,
        typer.Option(
            "--sha256", metavar="DIGITS", help="First 8 or more digits of the SHA-256 on the page that the board read."
        ),
    ] = None,
    replace: Annotated[
        bool, typer.Option("--replace", help="Replace an earlier seal, after a change to the protocol or a mistake.")
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="Replace without asking for confirmation, e.g., in a script.")
    ] = False,
) -> None:
    """Record the board's approval of a protocol.

    The command writes STUDY.seal.toml next to the protocol, with the SHA-256 of the approved version. `palpate run`
    refuses a protocol that is not sealed, that has changed since, or whose approval has expired. Before it replaces
    an earlier seal, the command shows that seal and asks.
    """
    from palpate.experiment.protocol import approval, files
    from palpate.experiment.protocol.approval import sealing

    protocol = files.load(protocol_file)
    # Nobody can approve a stimulus that is not there, or is another.
    files.companions(protocol)
    path = approval.seal_path(protocol_file)
    if yes and not replace:
        raise PalpateError(
            "got --yes without --replace", remedy="use --yes only with --replace", allowed="both, or neither"
        )
    replaces = path.exists()
    if replaces and replace and not yes:
        options.confirm(sealing.replaced(protocol_file, protocol), "replace", "no seal was replaced")
    sealed = sealing.write(
        protocol_file,
        protocol,
        approval_number=approval_number,
        board=protocol.ethics.board,
        approved_on=approved_on,
        expires_on=expires_on,
        page_sha256=sha256,
        replace=replace,
    )
    limits = protocol.exposure
    typer.echo(
        f"Sealed study {protocol.study.id} from {sealed.approved_on} to {sealed.expires_on}: vibration at most "
        f"{limits.vibration_peak_m_s2:g} m/s^2, masker at most {limits.masker_level_db_a:g} dB(A), session at most "
        f"{limits.session_min:g} min.\nSealed {sealed.protocol_sha256}: {path}"
    )
    if replaces:
        typer.echo("The earlier seal has been replaced. Existing datasets retain their copies of it.")


@commands.command(epilog="Example: palpate schema protocol --out protocol.schema.json")
def schema(
    of: Annotated[
        Literal["protocol", "rig", "results"],
        typer.Argument(metavar="protocol|rig|results", help="The file to describe."),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE.json", help="File to write [default: print it].")
    ] = None,
) -> None:
    """Write the JSON Schema of a protocol, a rig or results.

    An editor with a TOML language server can then complete keys, show their meaning, and mark errors. New files
    begin with a line `#:schema protocol.schema.json` or `#:schema rig.schema.json`, which names the schema in the
    same folder. Only `palpate check` checks rules that involve several keys. `results` is for programs that read the
    results.json of palpate analyse.
    """
    import json

    if of == "results":
        from palpate.analysis import documents

        content = Path(documents.__file__).with_name("results.schema.json").read_bytes()
        if out is None:
            options.put(json.loads(content))
            return
        options.put_file(out, content)
        typer.echo(f"Schema: {out}.")
        return
    from palpate.experiment.apparatus.rig import Rig
    from palpate.experiment.protocol import files
    from palpate.experiment.protocol.designs import factors
    from palpate.experiment.settings.schema import schema as described

    made = described(Rig if of == "rig" else files.ProtocolFile, f"{of} file of palpate")
    made = made if of == "rig" else factors.relaxed(made)
    if out is None:
        options.put(made)
        return
    options.put_file(out, (json.dumps(made, indent=1) + "\n").encode())
    typer.echo(f"Schema: {out}. To use it, begin a {of} file with the line: #:schema {out.name}")


@commands.command(epilog="Example: palpate preregister study.toml --power power.json")
def preregister(
    protocol_file: ProtocolFile,
    power: Annotated[
        Path | None, typer.Option("--power", metavar="FILE.json", help="Output of `palpate power PROTOCOL --json`.")
    ] = None,
) -> None:
    """Write a protocol's plan as an OSF preregistration.

    The text follows the form "OSF Preregistration": study information, design plan, sampling plan, variables,
    analysis plan, other. Its sources are the protocol, its planned tests and, with --power, the simulated power.
    Fields that only your laboratory can complete are marked TO BE FILLED IN. It states the SHA-256 of the protocol
    and whether it is sealed.
    """
    from palpate.experiment.clock import day, wall_ns
    from palpate.experiment.protocol import files
    from palpate.experiment.protocol.page import preregistration

    typer.echo(preregistration.text(files.load(protocol_file), protocol_file, day(wall_ns()), power), nl=False)
