"""The commands of the analyst's desk: analyse, export, audit, power, numerics, imports, and status of a study."""

import re
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from palpate.experiment.cli import options
from palpate.experiment.cli.options import Json, ProtocolFile
from palpate.experiment.errors import Finding, Interrupted, PalpateError, PowerError, PublishedError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from palpate.experiment.dataset.status import Status

commands = options.room()

T = TypeVar("T")

PARTICIPANTS = "4,5,6,7,8,10,12,15,20,25,30,40"


@commands.command(epilog="Example: palpate analyse participants/okamoto2012 --out tables")
def analyse(
    datasets: Annotated[
        list[Path], typer.Argument(metavar="DATASET...", help="Folders of BIDS datasets; several are pooled.")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for tables, figures and report [default: inside DATASET].")
    ] = None,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw the figures.")] = True,
    titles: Annotated[bool, typer.Option("--titles", help="Put a title in each figure, for slides.")] = False,
    dissimilarities: Annotated[
        Path | None,
        typer.Option(
            "--dissimilarities", help="CSV file with the dissimilarities of materials, from `palpate validate`."
        ),
    ] = None,
    full: Annotated[bool, typer.Option("--full", help="Print every section, not only the answers.")] = False,
    prose: Annotated[
        bool,
        typer.Option(
            "--text", help="Print methods and results paragraphs for a paper, each number with its table row."
        ),
    ] = False,
    as_json: Json = False,
) -> None:
    """Make a dataset's tables and report.

    The results are confusion matrices with intervals, tests, information, d', similarities and biases, ANOVAs,
    ICCs, single-trial models, figures and one HTML report. Next to each published test is a test with participants
    as the unit. The report compares the planned analysis with what was run, and marks every table as planned,
    published, ours or exploratory. A published study is compared with its paper, value by value.
    """
    _believe(*datasets)
    found = analysed(
        datasets, out, as_json=as_json, figures=figures, titles=titles, full=full, dissimilarities=dissimilarities,
        prose=prose,
    )  # fmt: skip
    options.put(found)


@commands.command(epilog="Example: palpate export participants/okamoto2012 --out okamoto2012-tables")
def export(
    datasets: Annotated[
        list[Path], typer.Argument(metavar="DATASET...", help="Folders of BIDS datasets; several are pooled.")
    ],
    out: Annotated[
        Path, typer.Option("--out", help="Folder for the tables; inside a dataset it must be in derivatives.")
    ],
) -> None:
    """Write tables for R, JASP and PsychoPy users.

    The tables are tidy trials, counts in the long layout, one row per participant in the wide layout, trials with
    PsychoPy's columns, everything that was left out, and a dictionary of every column.
    """
    from palpate.analysis import export as exports

    _believe(*datasets)
    for path in exports.export(datasets, out):
        typer.echo(path)


@commands.command(epilog="Example: palpate audit okamoto2012")
def audit(
    context: typer.Context,
    target: Annotated[
        str,
        typer.Argument(
            metavar="STUDY|FILE|DATASET",
            help="Shipped study (its id), paper (.html, .csv, .txt), TOML file of printed numbers, or dataset folder.",
        ),
    ],
    against: Annotated[
        Path | None,
        typer.Option(
            "--against", help="TOML file of the paper to compare a dataset with [default: the one with its study's id]."
        ),
    ] = None,
    participants: Annotated[
        str | None,
        typer.Option(
            "--participants",
            help="With .html or .csv: participants in the confusion tables, as one number or one per table (15,10).",
        ),
    ] = None,
    trials: Annotated[
        int | None,
        typer.Option(
            "--trials",
            min=1,
            max=10_000,
            help="With .html or .csv: trials per participant and material, if known and the same for all.",
        ),
    ] = None,
    chance: Annotated[
        str | None,
        typer.Option(
            "--chance", help="With .html or .csv: the chance level for t-tests of materials, such as 1/4 or 0.25."
        ),
    ] = None,
    encoding: options.Encoding = None,
    decimal: options.Decimal = None,
    as_json: Json = False,
) -> None:
    """Check printed numbers against each other or against a dataset.

    The audit recomputes every statistic as the interval that rounding or truncation of the other numbers allows. It
    checks whether means, SDs and rows can come from whole counts, and names the simplest mistake that explains a
    wrong number. If one wrong number explains several disagreements, only that one is reported as wrong.

    From an HTML page or a CSV file it reads confusion, ANOVA and t-test tables; from a page or a text also
    sentences such as "t(11) = 8.14, p < .001". It lists what it could not read. A TOML file can state more:
    `palpate docs papers` shows how to write one. A disagreement is a finding, not an error, so the exit code is 0.
    """
    from palpate.analysis.audit import audit as audits
    from palpate.analysis.published.paper import Stated
    from palpate.experiment.settings import delimited

    _believe(Path(target))
    people = tuple(_sizes(participants, PublishedError)) if participants else ()
    share = re.fullmatch(r"0?(\.[0-9]{1,9})|([1-9][0-9]{0,3})/([1-9][0-9]{0,3})", chance or "1/2")
    if share is None or not 0 < float(share[1] or int(share[2]) / int(share[3])) < 1:
        raise PublishedError("--chance", f"got {chance}", "give one", allowed="a proportion such as 1/4 or 0.25")
    file = delimited.Stated(encoding, decimal, command=options.command_line(context))
    beside = people or trials or chance or encoding or decimal or target.lower().endswith((".csv", ".tsv"))
    stated = Stated(people, trials, chance, file) if beside else None
    with options.working("Comparing the numbers", quiet=as_json):
        result = audits.audit(target, against, stated)
    options.put(result.as_dict() if as_json else result.text(options.columns(80)))


@commands.command(epilog="Example: palpate power okamoto2012 --participants 5-30 --out power")
def power(
    protocol_file: ProtocolFile,
    model: Annotated[
        str,
        typer.Option(
            "--model",
            help="How simulated participants answer: 'published' (as in this study's published tables), the id of "
            "another published study, a dataset folder or a TOML file; or two numbers, such as the proportion "
            "correct and the intraclass correlation (0.8,0.15).",
        ),
    ] = "published",
    participants: Annotated[
        str, typer.Option("--participants", help="Numbers of participants to try, such as 5,10,15 or 5-30.")
    ] = PARTICIPANTS,
    studies: Annotated[
        int | None,
        typer.Option(
            "--studies",
            help="Number of studies to simulate for each size [default: 10000]; for thresholds, number of sessions "
            "for each simulated observer [default: 100].",
        ),
    ] = None,
    alpha: Annotated[
        float | None, typer.Option("--alpha", help="Alpha for all tests [default: each test's own].")
    ] = None,
    target: Annotated[float, typer.Option("--target", help="Power to reach.")] = 0.8,
    seed: Annotated[
        int, typer.Option("--seed", min=0, max=options.LARGEST_SEED, help="Seed for all random draws.")
    ] = 1,
    jobs: Annotated[int, typer.Option("--jobs", min=0, help="Number of parallel processes; 0 means one per core.")] = 0,
    looks: Annotated[
        str | None,
        typer.Option("--looks", help="Numbers of participants after which a study may stop early, such as 10,15,20."),
    ] = None,
    rule: Annotated[
        str | None,
        typer.Option(
            "--rule",
            help="With --looks: the stopping rule (obrien-fleming, pocock or bayes) [default: obrien-fleming].",
        ),
    ] = None,
    alike: Annotated[
        float | None,
        typer.Option(
            "--alike",
            help="Share of the between-participant variance common to all tasks and materials [default: 0; with "
            "--looks 0.5].",
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option("--scheduler", metavar="ADDRESS", help="Simulate on the cluster of this Dask scheduler."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for the tables (CSV, Markdown, LaTeX) and the plot.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Estimate how many participants a study needs.

    The command simulates whole studies from a choice model and tests each as planned in the protocol. The result is
    the power by number of participants, with its Monte Carlo error, and the type I error rate when answers are at
    chance but participants differ as much. The same seed gives the same result on any number of cores or machines. With
    --looks, the simulated studies have interim looks, and power, type I error rate and mean number of participants
    include early stopping. For a detection task with levels, the command shows bias and SD of the thresholds of
    simulated observers.
    """
    from palpate.analysis.designs import planned_design
    from palpate.analysis.documents import output
    from palpate.experiment.protocol import files

    if rule is not None and looks is None:
        raise PowerError("--rule", f"got {rule} without --looks", "add --looks", allowed="both, or neither")
    sizes = _sizes(participants)
    if out is not None:
        output.check(out, (), "power")
    protocol = files.load(protocol_file)
    if any(task.levels for task in protocol.tasks) and (own := planned_design(protocol).thresholds):
        from palpate.experiment.study.levels import methods

        _refuse_unused({"--looks": looks, "--rule": rule, "--alpha": alpha, "--alike": alike, "--scheduler": scheduler})
        thresholds = import_module(own)
        sessions = thresholds.SESSIONS if studies is None else studies
        run = partial(thresholds.run, protocol, methods(protocol), sessions=sessions, seed=seed, jobs=jobs)
        off = _simulated(run, quiet=as_json)
        if out is not None:
            thresholds.write(off, out)
        options.put(thresholds.as_dict(off) if as_json else thresholds.text(off))
        return
    _believe(Path(model))
    from palpate.analysis.power import simulate

    with options.working("Preparing the simulated participants", quiet=as_json):
        planned, chosen = simulate.prepare(protocol, model, alpha, alike if looks is None else None)
    from palpate.analysis.power import report, sequential

    drawn = {"studies": 10_000 if studies is None else studies, "seed": seed}
    if looks is not None:
        at, stops = _sizes(looks, option="--looks"), rule or "obrien-fleming"
        run = partial(sequential.run, planned, chosen, study=protocol.study.id, rule=stops, looks=at, alike=alike)
        found = _simulated(partial(run, **drawn), quiet=as_json)
        if out is not None:
            sequential.write(found, out)
        options.put(sequential.as_dict(found) if as_json else sequential.text(found))
        return
    on_cores, on_cluster = partial(simulate.on_cores, jobs=jobs), partial(simulate.on_cluster, address=scheduler or "")
    runner = on_cores if scheduler is None else on_cluster
    whole = partial(simulate.run, protocol, planned, chosen, participants=sizes, target=target, runner=runner)
    result = _simulated(partial(whole, **drawn), quiet=as_json)
    if out is not None:
        report.write(result, out)
    options.put(report.as_dict(result) if as_json else report.text(result))


def _refuse_unused(given: "Mapping[str, object]") -> None:
    """Raise `PowerError` for the first option with a value, of those that nothing uses for a detection with levels."""
    for option in (name for name, value in given.items() if value is not None):
        remedy = "leave it out: all observers are simulated as in the protocol"
        raise PowerError(option, "this option has no effect for a detection task with levels", remedy)


def _simulated(run: "Callable[..., T]", *, quiet: bool) -> "T":
    """Return what a simulation finds, and show how far it is."""
    from palpate.analysis.power.simulate import LABEL

    try:
        with options.progress(LABEL, quiet=quiet) as (total, tick):
            return run(total=total, tick=tick)
    except KeyboardInterrupt:
        raise Interrupted("the simulation was interrupted", remedy="nothing was written") from None


@commands.command(epilog="Example: palpate numerics --quick --out numerics")
def numerics(
    quick: Annotated[bool, typer.Option("--quick", help="Use fewer sizes and repetitions.")] = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder for tables (CSV, Markdown), plots, and the played signals (.npz)."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Measure the error and run time of each way to compute a stimulus.

    The command measures each way to compute a stimulus or voltages, tries extreme cases, each with its invariant,
    and compares the error budget of a rig's output with the truth. The exit code is 1 if an invariant, a claimed
    bound or a budget fails.
    """
    from palpate.analysis.numerics import numerics as measured
    from palpate.analysis.numerics import report

    if out is not None:
        report.check_out(out)
    with options.progress("numerics", quiet=as_json) as (total, tick):
        result = measured.run(measured.QUICK if quick else measured.FULL, total=total, tick=tick)
    if out is not None:
        options.at_once("Drawing the plots ...")
        report.write(result, out)
    options.put(report.as_dict(result) if as_json else report.text(result))
    if out is not None and not as_json:
        typer.echo(f"Tables, plots and played signals: {out}")
    if result.failed:
        raise typer.Exit(1)


@commands.command(
    "import-counts",
    epilog="Example: palpate import-counts --task virtual=virtual.csv --task real=real.csv --study okamoto2012 "
    "--out again",
)
def import_counts(
    context: typer.Context,
    task: Annotated[
        list[str],
        typer.Option("--task", help="TASK=CSV: a file with the columns participant,presented,answered,count."),
    ],
    study: Annotated[str, typer.Option("--study", help="Id of the study.")],
    out: Annotated[Path, typer.Option("--out", help="Folder of the new dataset.")],
    source: Annotated[str | None, typer.Option("--source", help="Source of the counts.")] = None,
    measured: Annotated[
        bool, typer.Option("--measured", help="The counts are answers of your own participants, not printed counts.")
    ] = False,
    encoding: options.Encoding = None,
) -> None:
    """Make a dataset from printed or measured counts.

    A dataset of printed counts is labeled as a reconstruction without original data. With --measured it is labeled
    IMPORTED: answers that a laboratory measured elsewhere, in which a participant's number means the same person in
    every task. The order of trials is unknown in both. --measured also needs --source, which states where they were
    measured.
    """
    from palpate.experiment.dataset.imports import reconstruction
    from palpate.experiment.settings.delimited import Stated

    pairs = dict(map(reconstruction.parse_task, task))
    stated = Stated(encoding, command=options.command_line(context))
    text = reconstruction.study_text(study, pairs, source, measured=measured, stated=stated)
    made = reconstruction.import_counts(pairs, out, study=text, stated=stated)
    read_as = (f"{path}: {reconstruction.read_as(path, stated).sentence()}" for path in pairs.values())
    typer.echo("\n".join([*read_as, f"Dataset: {made}"]))


@commands.command(
    "import-trials",
    epilog="Example: palpate import-trials data/*.csv --presented material --answered key_resp.keys --participant "
    "participant --seconds key_resp.rt --map 1=felt --map 2=cork --study lab --out participants/lab",
)
def import_trials(
    context: typer.Context,
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="One or more CSV or JSON files of trials.")],
    presented: Annotated[
        str, typer.Option("--presented", help="Column with the material presented, or presented first.")
    ],
    study: Annotated[str, typer.Option("--study", help="Id of the study.")],
    out: Annotated[Path, typer.Option("--out", help="Folder of the new dataset.")],
    answered: Annotated[
        str | None,
        typer.Option("--answered", help="Column with the answer: a material, a key, or the chosen material."),
    ] = None,
    correct: Annotated[
        str | None, typer.Option("--correct", help="Without --answered, for two materials: column with right or wrong.")
    ] = None,
    second: Annotated[
        str | None, typer.Option("--second", help="For comparisons: column with the material presented second.")
    ] = None,
    participant: Annotated[str | None, typer.Option("--participant", help="Column with the participant.")] = None,
    in_name: Annotated[
        str | None,
        typer.Option(
            "--participant-in-name",
            help="Instead of a column: where the label is in the file name, such as 'sub-{}_*.csv'.",
        ),
    ] = None,
    task: Annotated[
        str | None, typer.Option("--task", help="Column with the task or group [default: one task].")
    ] = None,
    trial: Annotated[
        str | None,
        typer.Option("--trial", help="Column with the trial's number in its task [default: the order of the rows]."),
    ] = None,
    session: Annotated[
        str | None,
        typer.Option("--session", help="Column with the session, if a participant did a task more than once."),
    ] = None,
    seconds: Annotated[str | None, typer.Option("--seconds", help="Column with response times in seconds.")] = None,
    milliseconds: Annotated[
        str | None, typer.Option("--milliseconds", help="Column with response times in milliseconds.")
    ] = None,
    answers: Annotated[
        list[str] | None,
        typer.Option("--map", help="KEY=MATERIAL: the material that a key or code means as an answer."),
    ] = None,
    shown: Annotated[
        list[str] | None,
        typer.Option(
            "--map-presented", help="CODE=MATERIAL: the material that a code means in the --presented column."
        ),
    ] = None,
    where: Annotated[
        list[str] | None, typer.Option("--where", help="COLUMN=VALUE: use only rows with this value.")
    ] = None,
    leave_out: Annotated[
        list[str] | None,
        typer.Option(
            "--leave-out",
            help="COLUMN=VALUE: exclude rows with this value and report how many (* means any value, [*, *] any list); "
            "or *=again: exclude exact copies of earlier rows.",
        ),
    ] = None,
    missing_time: Annotated[
        list[str] | None,
        typer.Option(
            "--missing-time", help="Response times to treat as missing: negative, zero, or the value of a cell."
        ),
    ] = None,
    material: Annotated[
        list[str] | None,
        typer.Option(
            "--material",
            help="A material; repeat this option in the order for the tables [default: presented materials, A to Z].",
        ),
    ] = None,
    people: Annotated[
        list[str] | None,
        typer.Option(
            "--map-participant", help="CELL=LABEL: the participant that a cell in the --participant column means."
        ),
    ] = None,
    source: Annotated[
        str, typer.Option("--source", help="Where, when and how the answers were measured.")
    ] = "the laboratory's tables",
    encoding: options.Encoding = None,
    decimal: options.Decimal = None,
    as_json: Json = False,
) -> None:
    """Make a dataset from another program's trial files.

    The files are CSV from PsychoPy, jsPsych, OpenSesame, Gorilla or a spreadsheet, or JSON from jsPsych. Rows
    without a material are instructions or breaks and are skipped; an empty answer, or None, is a trial without an
    answer. With --second, trials are comparisons of two materials. The dataset is labeled IMPORTED: a laboratory's
    own answers, measured elsewhere. It does not contain copies of the files, because they may identify
    participants; it stores the line of each trial and the hash of each file.
    """
    from palpate.experiment.dataset.imports import imported, layout
    from palpate.experiment.settings.delimited import Stated

    if seconds is not None and milliseconds is not None:
        raise PalpateError(
            "got --seconds and --milliseconds", remedy="give the one for the file's unit", allowed="one of them"
        )
    columns = layout.Layout(
        presented,
        answered,
        participant,
        task,
        trial,
        seconds,
        milliseconds,
        answers=layout.pairs("--map", answers or ()),
        materials=layout.pairs("--map-presented", shown or ()),
        where=layout.pairs("--where", where or ()),
        people=layout.pairs("--map-participant", people or ()),
        second=second,
        correct=correct,
        in_name=in_name,
        leave_out=layout.cells(leave_out or ()),
        missing_times=missing_time or (),
        session=session,
    )
    stated = Stated(encoding, decimal, command=options.command_line(context))
    with options.shares(quiet=as_json or not options.is_long(files)) as done:
        made = imported.import_trials(
            files, out, columns, study=study, source=source, materials=material or (), stated=stated, done=done
        )
    if as_json:
        options.put(made.as_dict())
    else:
        doubts = (f"CAUTION: {doubt.clause()}" for doubt in made.doubts)
        typer.echo("\n".join([*made.files, *made.sentences, *doubts, f"Dataset: {made.root}"]))


@commands.command(epilog="Example: palpate status participants/study --figure flow.pdf")
def status(
    study: options.StudyPlace,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Also draw the flow of participants, as .svg, .png or .pdf.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Show a study's progress and its next step.

    The order of a participant's tasks is not shown until their first session has begun. This command changes no
    files. The exit code is 1 if there is any doubt about the evidence.
    """
    options.at_once("Reading the study; this takes a few seconds.")
    if figure is not None and figure.suffix.lower() not in (".svg", ".png", ".pdf"):
        raise PalpateError(
            f"--figure {figure}", f"got the suffix '{figure.suffix}'", "give one", allowed=".svg, .png, .pdf"
        )
    found = status_of(study)
    if figure is not None:
        from palpate.analysis.documents import drawing
        from palpate.analysis.documents.flow import flow

        drawn = {".svg": drawing.svg, ".png": drawing.png, ".pdf": drawing.pdf}
        aside, stages = found.flow()
        chart = flow(found.heading, f"Flow of participants on {found.day}: {found.title}", aside, stages)
        options.put_file(figure, drawn[figure.suffix.lower()](chart))
    shown = f"\n\nFigure: {figure}" if figure else ""
    options.put(found.as_dict() if as_json else found.text() + shown)
    raise typer.Exit(1 if found.doubts else 0)


def status_of(study: Path) -> "Status":
    """Return how far a study is, with who is excluded by its rules where its tables can tell.

    A protocol file of which there is no study yet stands for what was practiced of it, if anything was.
    """
    from dataclasses import replace

    from palpate.experiment.clock import day, wall_ns
    from palpate.experiment.dataset import status as statuses
    from palpate.experiment.dataset import tables

    if study.is_file():
        own, practiced = (options.default_folder(study, practice=one) for one in (False, True))
        study = practiced if practiced.exists() and not own.exists() else study
    found = statuses.status(study, day(wall_ns()))
    done = {one.participant for one in found.those("done")}
    if found.doubts:
        return replace(found, excluded=None)
    if not done:
        return found
    from palpate.analysis.reading import dataset as reading

    try:
        tables.check_tables(found.root)
        whole = [one for one in reading.read(found.root).exclusions if one.trial is None and one.participant in done]
    except PalpateError as error:
        what = f"The exclusions are unknown: {error.finding.observation()}"
        unknown = Finding(what, allowed=error.finding.allowed, remedy=error.finding.remedy)
        return replace(found, excluded=None, reminders=(*found.reminders, unknown))
    return replace(found, excluded={one.participant: one.reason for one in whole})


def analysed(
    datasets: list[Path],
    out: Path | None,
    *,
    as_json: bool,
    figures: bool,
    pictures: bool = True,
    titles: bool = False,
    full: bool = False,
    dissimilarities: Path | None = None,
    prose: bool = False,
) -> object:
    """Analyse datasets, and return what was found, in the width of the terminal or as a document for JSON."""
    from palpate.analysis import analyse as analyses
    from palpate.analysis.documents.tables import WIDTH

    drawn = {"figures": figures, "pictures": pictures, "titles": titles}
    with options.working("Reading the dataset", quiet=as_json) as say:
        result = analyses.analyse(datasets, out, **drawn, dissimilarities=dissimilarities, say=say)
    if as_json:
        return result.as_dict()
    width = options.columns(WIDTH)
    return result.write_up(width) if prose else result.text(width, full=full)


def _believe(*datasets: Path) -> None:
    """Refuse a dataset whose journals are not all its own, or do not give its tables; tell where there are none."""
    from palpate.experiment.cli import tell
    from palpate.experiment.dataset import tables

    for dataset in datasets:
        for line in tables.check_analysed(dataset):
            tell(f"palpate: {line}")


def _sizes(text: str, error: type[PalpateError] = PowerError, option: str = "--participants") -> list[int]:
    """Return the sizes that `5,10,15`, `5-30` or both together name."""
    found: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*([0-9]{1,6})(?:\s*-\s*([0-9]{1,6}))?\s*", part)
        if match is None or (match[2] and int(match[2]) < int(match[1])):
            raise error(
                f"{option}: got {text!r}; allowed: whole numbers and ascending ranges, separated by commas, such as "
                "5,10,20-30"
            )
        found += range(int(match[1]), int(match[2] or match[1]) + 1)
    return found
