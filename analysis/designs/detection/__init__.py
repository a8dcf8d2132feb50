"""Detection: a trial asks whether something was felt, or in which of two intervals.

A study whose answers are yes and no, or first and second, comes in. Thresholds by the rule of the levels and by fitted
psychometric functions, tracks and d' go out, with the sections and figures that show them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from palpate.analysis.designs import AnalysisDesign, Described
from palpate.analysis.designs.detection import frequencies, results
from palpate.analysis.designs.detection.results import Detections, TaskDetections, Threshold, Track
from palpate.analysis.documents.page import ON_METHODS
from palpate.analysis.documents.tables import Asked, Column, Record, Section, formulas, number, plural, span, tabulate
from palpate.analysis.published.numbers import Published
from palpate.analysis.reading.dataset import Say
from palpate.analysis.reading.study import Study
from palpate.analysis.report import plan
from palpate.analysis.report.answers import left_and_sure
from palpate.analysis.report.heard import heard_sections
from palpate.experiment.errors import DatasetError

if TYPE_CHECKING:
    import pandas as pd

    from palpate.experiment.protocol.models import Levels, PlannedTest

THRESHOLD, SENSITIVITY = "threshold", "sensitivity"
"""The tests that a protocol may plan."""

QUESTIONS = {THRESHOLD: "At what level is a signal felt?", SENSITIVITY: "How large is d'?"}
"""What a test asks where no protocol words it."""

ENOUGH = 10
"""With fewer trials at a level the report shows no d' there, but the file does; ours."""

OVER = (
    Column("task", left=True), Column("signal", left=True), Column("by", left=True), Column("n", "participants"),
    Column("db", "dB", 2), Column("sd", "SD", 2), Column(("low", "high"), "95 % CI", 2), Column("m_s2", "m/s²", 4),
)  # fmt: skip
TRACKS = (
    Column("task", left=True), Column("participant", left=True), Column("signal", left=True), Column("trials"),
    Column("threshold_db", "fit dB", 2), Column(("low", "high"), "95 % CI", 2), Column("threshold_m_s2", "m/s²", 4),
    Column("spread_db", "spread dB", 2), Column("lapse", decimals=2), Column("guess", decimals=2),
    Column(("guess_low", "guess_high"), "guess 95 %", 2),
    Column("reversals"), Column("rule_db", "rule dB", 2), Column("rule_sd", "SD", 2),
    Column("rule_share", "at share", 3), Column("at_share_db", "fit there", 2), Column("statement", "", left=True),
)  # fmt: skip
D_PRIMES = (
    Column("task", left=True), Column("participant", left=True), Column("signal", left=True),
    Column("x_db", "dB", 2), Column("right"), Column("trials"), Column("hits"), Column("signals"),
    Column("false_alarms", "false alarms"), Column("others"), Column("d", "d'", 2), Column("se", "SE", 2),
    Column("criterion", "c", 2),
)  # fmt: skip
STEPS = (
    Column("task", left=True), Column("participant", left=True), Column("signal", left=True), Column("trial"),
    Column("level", decimals=6), Column("level_db", "dB", 2), Column("answered", left=True), Column("right"),
    Column("reversal"),
)  # fmt: skip

FORMULA = {
    "yes or no": "d' = z(hits) - z(false alarms), false alarms from catch trials",
    "two intervals": "d' = (z(hits) - z(false alarms)) / √2, which is √2 z(right) without a bias; a hit is "
    '"first" when the signal was first, a false alarm is "first" when it was second',
}
"""The decision rule of d', in words."""


def sections(study: Study, found: Detections, printed: Published | None, _: Section | None) -> tuple[Section, ...]:
    """Return every section, in reading order: what was found, what was planned, results by their standing, checks."""
    stands = plan.standing(study, printed)
    ids = [task.task.id for task in found.tasks]
    tones = frequencies.section(found)
    parts = {
        stands.results: (
            plan.marked(_thresholds(found), plan.mark_of(stands, THRESHOLD, ids)),
            *((plan.marked(tones, plan.mark_of(stands, THRESHOLD, ids)),) if tones else ()),
            plan.marked(_tracks(found), plan.mark_of(stands, THRESHOLD, ids)),
            plan.marked(_sensitivity(found), plan.mark_of(stands, SENSITIVITY, ids)),
        ),
        plan.EXCLUDED: (plan.exclusions_section(study),),
        ON_METHODS: tuple(plan.marked(one, plan.DESCRIPTIVE) for one in heard_sections(study)),
    }
    return (
        _answers(study, found, stands),
        _overview(study, found),
        Section("procedure", "How levels, thresholds and d' were determined", tuple(_procedure(study, found))),
        *(replace(section, part=part) for part, of in parts.items() for section in of),
    )


def _answers(study: Study, found: Detections, stands: plan.Standing) -> Section:
    """Return each planned test with its one answer, or else thresholds."""
    planned = {(test.test, test.tasks): plan.first_question(test) for test in study.plans()}
    if not planned:
        planned = {(THRESHOLD, tuple(task.task.id for task in found.tasks)): QUESTIONS[THRESHOLD]}
    asked = tuple(
        Asked(
            question,
            " ".join(_answer(test, task) for task in found.tasks if task.task.id in tasks),
            stands.mark(test, *tasks),
            _open(found, tasks) if test == THRESHOLD else (),
        )
        for (test, tasks), question in planned.items()
    )
    return Section("answers", "Questions and answers", (left_and_sure(study),), asked=asked)


def _answer(test: str, task: TaskDetections) -> str:
    """Return the answer of one task in a sentence."""
    if test == SENSITIVITY:
        if means := results.mean_d(task):
            of = [
                f"the mean d' of {signal} is {number(one.value, 2)} ({span(one.low, one.high, 2)}) in "
                f"{plural(one.n, 'participant')}"
                for signal, one in means.items()
            ]
            return f"{task.task.id}: {'; '.join(of)}."
        known = [one.d.d for track in task.tracks for one in track.by_level if one.d and one.trials >= ENOUGH]
        if not known:
            return f"{task.task.id}: no level has enough trials for d' ({ENOUGH})."
        return f"{task.task.id}: d' ranges from {min(known):.2f} to {max(known):.2f} across participants and levels."
    words = "; ".join(map(_threshold_words, task.thresholds))
    return f"{task.task.id}, mean thresholds: {words}." if words else f"{task.task.id}: no answer to a signal."


def _open(found: Detections, tasks: Sequence[str]) -> tuple[str, ...]:
    """Return a warning if the answers leave thresholds open, or nothing."""
    tracks = [one for task in found.tasks if task.task.id in tasks for one in task.tracks]
    names = [_name(one) for one in tracks if one.fit and one.fit.at_bound and not one.beyond]
    told = f"the fitted threshold of {', '.join(names)} has a limit on one side only."
    beyond = [f"{_name(one)} {one.beyond}" for one in tracks if one.beyond]
    missed = f"the threshold is outside the range of levels and excluded from all means: {', '.join(beyond)}."
    return (*((told,) if names else ()), *((missed,) if beyond else ()))


def _name(of: Track) -> str:
    return f"sub-{of.participant} ({of.signal})"


def _threshold_words(of: Threshold) -> str:
    beyond = Counter(where for _, where in of.beyond)
    missed = "".join(f", {where} in {plural(count, 'other')}" for where, count in beyond.items())
    first, other, by = of.fitted, of.by_rule, "by the rule of the levels"
    if of.is_posterior:
        first, other, by = of.by_rule, of.fitted, "by the fit"
    if first is None:
        every = " and ".join(f"{where} in {plural(count, 'participant')}" for where, count in beyond.items())
        return f"{of.signal} {every}" if beyond else f"{of.signal} none"
    limits = "" if first.low is None or first.high is None else f" ({span(first.low, first.high, 1)})"
    peak = "" if of.peak_m_s2 is None else f", {of.peak_m_s2 * 10 ** (first.value / 20):.3g} m/s² at its peak"
    beside = "" if other is None else f"; {number(other.value, 1)} dB {by}"
    people = plural(first.n, "participant")
    return f"{of.signal} {number(first.value, 1)} dB{limits}{peak} ({people}{missed}{beside})"


def _overview(study: Study, found: Detections) -> Section:
    rows = tuple(
        {"task": task.task.id, "title": task.task.title,
         "participants": len({one.participant for one in task.tracks}), "trials": task.trials,
         "without_answer": task.unanswered}
        for task in found.tasks
    )  # fmt: skip

    def done(test: PlannedTest) -> str:
        of = [_answer(test.test, task) for task in found.tasks if task.task.id in test.tasks]
        return " ".join(of) or "not run: no trials"

    section = plan.overview(study, rows, done, (THRESHOLD, SENSITIVITY))
    times = [
        f"In {task.task.id}, the median response time was {task.response_time_s:.2f} s."
        for task in found.tasks
        if task.response_time_s is not None
    ]
    first, *rest = section.paragraphs
    return replace(section, paragraphs=(first, f"Answers are {found.rule}.", *times, *rest))


def _procedure(study: Study, found: Detections) -> Iterator[str]:
    """Yield what a paper's methods say of each task, and of what was computed."""
    for task in found.tasks:
        plans = [part.plan(one.participant, task.task.id) for part in study.parts for one in task.tracks]
        for levels in dict.fromkeys(one.task(task.task.id).levels for one in plans if one):
            yield f"In {task.task.title}, {_rule(levels)}."
        if beyond := [one for one in task.tracks if one.beyond]:
            where = " or ".join(dict.fromkeys(one.beyond for one in beyond))
            told = f"{len(beyond)} of {plural(len(task.tracks), 'track')} stayed at one end of the range of levels"
            yield f"{told}; their thresholds are {where} and excluded from all means."
    yield (
        "Cumulative normal functions of the level in dB were fitted to each participant's answers, with a Beta(1, 10) "
        "prior for lapses. Values are medians and central 95 % intervals of the posterior (Schuett et al. 2016)."
    )
    trials = {one.trials for task in found.tasks for one in task.catches}
    if found.rule == "two intervals":
        yield "The fit assumed a guessing rate of one half."
    elif trials:
        count = str(min(trials)) if len(trials) == 1 else f"{min(trials)} to {max(trials)}"
        yield (
            f"The false-alarm rate is that of each participant in {count} catch trials and is treated as exact; its "
            "95 % limits (Clopper-Pearson) are in the same table."
        )
    else:
        yield "There were no catch trials, so the fit assumed no false alarms."
    yield f"For {found.rule}, {FORMULA[found.rule]} (Macmillan and Creelman 2005), separately at each level."


def _rule(levels: Levels | None) -> str:
    """Return how the levels of a task were chosen."""
    if levels is None:
        return "every signal had one level"
    if levels.method == "constant":
        return f"levels were constant stimuli: {len(levels.grid)} levels, equally often, in a predetermined order"
    if levels.down is not None:
        up = levels.up or 1
        share = (up / (up + 1)) ** (1 / levels.down)
        source = "Levitt 1971" if up == 1 else "Kaernbach 1991"
        steps = f", with steps of {', then '.join(map(str, levels.steps))} levels" if levels.steps else ""
        kind = (
            f"a {levels.down}-down, 1-up staircase"
            if up == 1
            else f"a weighted staircase, lowered a step after {plural(levels.down, 'right answer')} in a row and "
            f"raised {up} after a wrong answer"
        )
        return (
            f"levels followed {kind}{steps} ({source}), which converges at "
            f"{share:.1%} correct, and ended after {plural(levels.reversals or 0, 'reversal')} at the latest"
        )
    return {
        "quest-plus": "levels were chosen by QUEST+ (Watson 2017)",
        "psi": "levels were chosen by psi (Prins 2013)",
    }[levels.method]


def _thresholds(found: Detections) -> Section:
    records: list[Record] = [
        {"task": task.task.id, "signal": one.signal, "by": by, "n": of.n, "db": of.value, "sd": of.sd, "low": of.low,
         "high": of.high, "m_s2": None if one.peak_m_s2 is None else one.peak_m_s2 * 10 ** (of.value / 20)}
        for task in found.tasks
        for one in task.thresholds
        for by, of in (("fit", one.fitted), ("rule of levels", one.by_rule))[:: -1 if one.is_posterior else 1]
        if of is not None
    ]  # fmt: skip
    notes = [
        "Means of the participants' thresholds, dB above level 1; SD and interval are across participants. m/s² is "
        "the peak at the mean. A fitted threshold is halfway between guessing and the lapse limit; the rule of the "
        "levels has its own proportion correct."
    ]
    return Section("thresholds", "Thresholds", (), (tabulate("Mean thresholds", OVER, records, notes),))


def _tracks(found: Detections) -> Section:
    records: list[Record] = [
        {**results.record(task.task.id, one), "participant": f"sub-{one.participant}", "statement": _doubt(one)}
        for task in found.tasks
        for one in task.tracks
    ]
    notes = ("Fit: 95 % interval of the posterior. Rule of levels: mean and SD of the reversals or of the posterior.",)
    table = tabulate("Thresholds of each participant", TRACKS, records, notes)
    said = tuple(
        f"{task.task.id}: {sum(one.false_alarms for one in task.catches)} of "
        f"{plural(sum(one.trials for one in task.catches), 'catch trial')} were answered yes."
        for task in found.tasks
        if task.catches
    )
    return Section("tracks", "Each participant", said, (table,))


def _doubt(of: Track) -> str:
    """Return why a track has no threshold, or why that is doubtful, or nothing."""
    is_open = "the answers bound the threshold on one side only" if of.fit and of.fit.at_bound else ""
    return "; ".join(filter(None, (of.estimate.statement, of.statement, "" if of.beyond else is_open)))


def _d_primes(found: Detections, least: int) -> list[Record]:
    return [
        {"task": task.task.id, "participant": f"sub-{track.participant}", "signal": track.signal, "x_db": one.x_db,
         "right": one.right, "trials": one.trials, "hits": one.hits, "signals": one.signals,
         "false_alarms": one.false_alarms, "others": one.others, "d": one.d and one.d.d, "se": one.d and one.d.se,
         "criterion": one.d and one.d.criterion}
        for task in found.tasks
        for track in task.tracks
        for one in track.by_level
        if one.trials >= least
    ]  # fmt: skip


def _sensitivity(found: Detections) -> Section:
    said = f"For {found.rule}: {FORMULA[found.rule]}; c is -(z(hits) + z(false alarms)) / 2."
    notes = (f"The table shows levels with {ENOUGH} or more trials; d-prime.csv has every level.",)
    table = tabulate("d' of each participant", D_PRIMES, _d_primes(found, ENOUGH), notes)
    return Section("sensitivity", "d'", (said,), (table,))


def _further(found: Detections) -> tuple[Section, ...]:
    frame = found.steps()
    steps: list[Record] = [
        {**dict(zip(frame.columns, row, strict=True)), "participant": f"sub-{row[1]}"}
        for row in frame.itertuples(index=False, name=None)
    ]
    return (
        Section("trials-of-tracks", "Tracks", (), (tabulate("Trials of each track", STEPS, steps),)),
        Section("d-prime", "d'", (), (tabulate("d' at every level", D_PRIMES, _d_primes(found, 1)),)),
    )


def _compute(study: Study, _: Published | None, dissimilarities: Path | None, _say: Say) -> Detections:
    if dissimilarities is not None:
        raise DatasetError(study.id, "got --dissimilarities and detection", "leave it out", allowed="one of them")
    return results.compute(study)


def _export(
    study: Study, frame: pd.DataFrame, exclusions: pd.DataFrame
) -> tuple[Mapping[str, pd.DataFrame], Described]:
    found = results.compute(study)
    return {
        "trials.csv": frame,
        "tracks.csv": found.steps(),
        "thresholds.csv": found.to_frame(),
        "exclusions.csv": exclusions,
    }, {}


DESIGN = AnalysisDesign(
    name="detection",
    trials="detections",
    function="detect",
    compute=_compute,
    sections=sections,
    numbers=lambda found: {"rule": found.rule, "blank": found.blank, "tasks": found.tasks},
    further=_further,
    methods=lambda: formulas(Path(__file__).with_name("methods.md")),
    export=_export,
    figures="palpate.analysis.designs.detection.figures",
    power="palpate.analysis.power.detections",
    thresholds="palpate.analysis.power.thresholds",
)
