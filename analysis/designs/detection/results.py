"""Results of detection: a threshold for each participant and signal, by the rule of the levels and by a fit, and d'.

Levels are in dB above level 1 of the protocol. A track is one participant's trials with one signal in one task, in the
order in which they were done. Answers at different levels are never counted together but in the fits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.special import ndtri
from scipy.stats import binomtest

from palpate.analysis.reading.study import Study, Task
from palpate.analysis.statistics.exact import Floats, NotDefined
from palpate.analysis.statistics.inference import CONFIDENCE
from palpate.analysis.statistics.participants import Mean, mean
from palpate.analysis.statistics.psychophysics.psychometric import Fit, Known, fit, psychometric
from palpate.analysis.statistics.psychophysics.sensitivity import Rule, Sensitivity, sensitivity
from palpate.experiment.errors import DatasetError
from palpate.experiment.protocol.designs.detection import FIRST, YES, Detection
from palpate.experiment.records.events import NO_ANSWER

if TYPE_CHECKING:
    import pandas as pd

    from palpate.experiment.protocol.models import Levels, Protocol

RULES: dict[int, Rule] = {1: "yes or no", 2: "two intervals"}
"""The decision rule of d', by how many intervals a trial has."""

TONE = {"frequency_hz", "amplitude_m_s2", "lasts_s"}
"""What a protocol states of a sinusoid."""

NUMBERS = (
    "reversals", "rule_db", "rule_sd", "rule_share", "threshold_db", "low", "high", "threshold_m_s2", "spread_db",
    "lapse", "guess", "guess_low", "guess_high", "frequency_hz", "threshold_rms_m_s2", "floor_rms_m_s2",
)  # fmt: skip
COLUMNS = (
    "task", "participant", "signal", "trials", "reversals", "method", *NUMBERS[1:], "open", "at_share_db", "beyond",
    "statement",
)  # fmt: skip
"""Columns of a row for each track, and those of them that are numbers."""


Beyond = Literal["", "above the highest level", "below the lowest level"]
"""Where a threshold is that is none of the levels: a track stayed at an end of its grid."""

STAYED = 0.5
"""A track with more of the later half of its trials at an end of its grid stayed there; ours."""


@dataclass(frozen=True)
class Step:
    """A trial of a track: `x_db` is its level, and `reversal` says that the track turned with it."""

    trial: int
    level: float
    x_db: float
    answered: str
    right: bool
    reversal: bool


@dataclass(frozen=True)
class AtLevel:
    """Answers at one level: yes, or first, to `signals` (`hits`) and to what was none, or second (`false_alarms`)."""

    x_db: float
    right: int
    trials: int
    hits: int
    signals: int
    false_alarms: int
    others: int
    d: Sensitivity | None


@dataclass(frozen=True)
class Estimate:
    """The threshold by the rule of the levels: dB, its standard deviation, and the share of right answers it is at.

    `method` says how; `statement` why there is none.
    """

    method: str
    db: float | None
    sd: float | None
    share: float | None
    statement: str = ""


@dataclass(frozen=True)
class Track:
    """One participant's trials with one signal; `peak_m_s2` is that of level 1, None where no protocol states it.

    `guess` is the share right without a signal that the fit takes, `guess_limits` its 95 % interval where it is that of
    catch trials. `at_share_db` is where the fitted function has the share of `estimate`. `statement` says why there is
    no fit, and `beyond` where the threshold is if the levels did not reach it. `frequency_hz` is that of a sinusoid,
    None of others.
    """

    participant: str
    signal: str
    peak_m_s2: float | None
    steps: tuple[Step, ...]
    by_level: tuple[AtLevel, ...]
    estimate: Estimate
    guess: float
    fit: Fit | None
    at_share_db: float | None
    statement: str
    frequency_hz: float | None
    beyond: Beyond = ""
    guess_limits: tuple[float, float] | None = None

    @property
    def known_db(self) -> Known | None:
        """Where half of what is not guessed is felt, dB, with its 95 % interval; None without any.

        By the posterior of the levels, if they have one: mean and 1.96 standard deviations. Otherwise by the fit.
        """
        if self.beyond:
            return None
        rule = self.estimate
        if rule.method == "posterior" and rule.db is not None and rule.sd is not None:
            half = float(ndtri((1 + CONFIDENCE) / 2)) * rule.sd
            return Known(rule.db, rule.db - half, rule.db + half)
        return None if self.fit is None else self.fit.threshold

    def rms_m_s2(self, db: float | None) -> float | None:
        """Return the rms of a sinusoid at so many dB, between its ramps, m/s^2; None of another signal."""
        peak = self.m_s2(db)
        return None if peak is None or self.frequency_hz is None else peak / 2**0.5

    def m_s2(self, db: float | None) -> float | None:
        """Return the peak at so many dB, m/s^2."""
        return None if db is None or self.peak_m_s2 is None else self.peak_m_s2 * 10 ** (db / 20)


@dataclass(frozen=True)
class Catches:
    """A participant's catch trials of a task, and how many were a yes."""

    participant: str
    trials: int
    false_alarms: int


@dataclass(frozen=True)
class Threshold:
    """Mean thresholds of a signal over participants, dB, by the fits and by the rule of the levels.

    `is_posterior` says that the rule is a posterior on the protocol's own thresholds, which errs less than the fit.
    `beyond` are the participants without one, and where theirs is; they are in no mean.
    """

    signal: str
    peak_m_s2: float | None
    fitted: Mean | None
    by_rule: Mean | None
    is_posterior: bool
    beyond: tuple[tuple[str, Beyond], ...] = ()


@dataclass(frozen=True)
class TaskDetections:
    """The answers of one task."""

    task: Task
    trials: int
    unanswered: int
    response_time_s: float | None
    tracks: tuple[Track, ...]
    catches: tuple[Catches, ...]
    thresholds: tuple[Threshold, ...]


@dataclass(frozen=True)
class Detections:
    """Everything that a study of detection gives; `rule` is the decision rule of d'."""

    materials: tuple[str, ...]
    blank: str | None
    rule: Rule
    tasks: tuple[TaskDetections, ...]

    def __repr__(self) -> str:
        told = "; ".join(f"{one.task.id}, {one.trials} trials, {len(one.tracks)} tracks" for one in self.tasks)
        return f"<Detections by {self.rule}: {told}>"

    def to_frame(self) -> pd.DataFrame:
        """Return a row for each task, participant and signal: both thresholds, and the fitted function."""
        import pandas as pd

        rows = [record(task.task.id, one) for task in self.tasks for one in task.tracks]
        return pd.DataFrame(rows, columns=COLUMNS).astype(dict.fromkeys(NUMBERS, "float64"))

    def steps(self) -> pd.DataFrame:
        """Return a row for each trial of each track: its level, the answer, and whether the track turned."""
        import pandas as pd

        rows = [
            (task.task.id, one.participant, one.signal, step.trial, step.level, step.x_db, one.m_s2(step.x_db),
             step.answered, int(step.right), int(step.reversal))
            for task in self.tasks for one in task.tracks for step in one.steps
        ]  # fmt: skip
        names = ["task", "participant", "signal", "trial", "level", "level_db", "peak_m_s2", "answered", "right",
                 "reversal"]  # fmt: skip
        return pd.DataFrame(rows, columns=names).astype({"peak_m_s2": "float64"})


def record(task: str, of: Track) -> dict[str, object]:
    """Return what a table has of a track."""
    found, rule, known = None if of.beyond else of.fit, of.estimate, of.known_db
    low, high = of.guess_limits or (None, None)
    return {
        "task": task, "participant": of.participant, "signal": of.signal, "trials": len(of.steps),
        "reversals": sum(step.reversal for step in of.steps), "method": rule.method, "rule_db": rule.db,
        "rule_sd": rule.sd, "rule_share": rule.share,
        "threshold_db": found and found.threshold.value, "low": found and found.threshold.low,
        "high": found and found.threshold.high, "threshold_m_s2": of.m_s2(found.threshold.value if found else None),
        "spread_db": found and found.spread.value, "lapse": found and found.lapse.value, "guess": of.guess,
        "guess_low": low, "guess_high": high, "open": bool(of.fit and of.fit.at_bound),
        "at_share_db": None if of.beyond else of.at_share_db, "beyond": of.beyond, "frequency_hz": of.frequency_hz,
        "threshold_rms_m_s2": of.rms_m_s2(known.value if known else None),
        "floor_rms_m_s2": of.rms_m_s2(known.low if known else None),
        "statement": "; ".join(filter(None, (rule.statement, of.statement))),
    }  # fmt: skip


def compute(study: Study) -> Detections:
    """Return every result of a study of detection. Raises `DatasetError` without a protocol, or with several."""
    known = [own for part in study.parts if part.protocol is not None and (own := part.protocol.find(Detection))]
    if len(known) < len(study.parts):
        got, remedy = "got a dataset that lacks its protocol", "restore sourcedata/protocol.toml"
        raise DatasetError(f"study {study.id}", got, remedy, allowed="a protocol that defines the blank")
    if len({(one.intervals, one.blank) for one in known}) > 1:
        got = "got datasets with different intervals or blanks"
        raise DatasetError(f"study {study.id}", got, "analyze each separately", allowed="the same in [detection]")
    own = known[0]
    tasks = tuple(_task(study, task, own) for task in study.tasks if len(study.trials(task.id)))
    return Detections(study.materials, own.blank, RULES[own.intervals], tasks)


def _task(study: Study, task: Task, own: Detection) -> TaskDetections:
    trials, attempts = study.trials(task.id), study.attempts[study.attempts["task"] == task.id]
    # A track moved on answers that a rule leaves out, too.
    said = attempts[attempts["counted"] & (attempts["answered"] != NO_ANSWER)].copy()
    shown = ["first", "second"] if own.intervals == 2 else ["presented"]
    is_signal = said[shown] != own.blank
    said["signal"] = said[shown].where(is_signal).bfill(axis=1).iloc[:, 0] if len(said) else ""
    said["lead"] = is_signal[shown[0]]
    said["claimed"] = said["answered"].isin((YES, FIRST))
    tracks, catches = [], []
    of = dict(list(said.groupby("participant")))
    for who, theirs in ((one, of[one]) for one in study.participants if one in of and of[one]["included"].any()):
        none = theirs[theirs["signal"].isna() & theirs["included"]]
        protocol = next(one for part in study.parts if who in part.participants if (one := part.plan(who, task.id)))
        caught = Catches(who, len(none), int(none["claimed"].sum()))
        catches += [caught] if len(none) else []
        by_signal = {signal: theirs[theirs["signal"] == signal] for signal in task.presented}
        tracks += [
            _track(rows, caught, one, protocol, task.id, own)
            for one, rows in by_signal.items()
            if rows["included"].any()
        ]
    times = said.loc[said["included"], "response_time_s"].dropna()
    return TaskDetections(
        task=task,
        trials=len(trials),
        unanswered=int((trials["answered"] == NO_ANSWER).sum()),
        response_time_s=float(times.median()) if len(times) else None,
        tracks=tuple(tracks),
        catches=tuple(catches),
        thresholds=tuple(
            _mean_threshold([one for one in tracks if one.signal == signal])
            for signal in task.presented
            if any(one.signal == signal for one in tracks)
        ),
    )


def _mean_threshold(tracks: Sequence[Track]) -> Threshold:
    """Return the means over the participants."""
    fitted = np.array([one.fit.threshold.value for one in tracks if one.fit and not one.beyond])
    by_rule = np.array([one.estimate.db for one in tracks if one.estimate.db is not None])
    peaks = {one.peak_m_s2 for one in tracks}
    return Threshold(
        tracks[0].signal,
        next(iter(peaks)) if len(peaks) == 1 else None,
        mean(fitted) if len(fitted) else None,
        mean(by_rule) if len(by_rule) else None,
        all(one.estimate.method == "posterior" for one in tracks),
        tuple((one.participant, one.beyond) for one in tracks if one.beyond),
    )


def mean_d(task: TaskDetections) -> dict[str, Mean]:
    """Return the mean d' over participants of each signal; nothing of a task of several levels."""
    if any(len(one.by_level) > 1 for one in task.tracks):
        return {}
    found: dict[str, list[float]] = {}
    for one in task.tracks:
        if one.by_level and (known := one.by_level[0].d) is not None:
            found.setdefault(one.signal, []).append(known.d)
    return {signal: mean(np.array(of)) for signal, of in found.items()}


def _track(rows: pd.DataFrame, caught: Catches, signal: str, protocol: Protocol, task: str, own: Detection) -> Track:
    planned = protocol.task(task)
    level = rows["level"].fillna(1.0).to_numpy(dtype=np.float64)
    x, right = 20 * np.log10(level), (rows["lead"] == rows["claimed"]).to_numpy(dtype=bool)
    turned, kept = reversals(right.tolist(), planned.levels), rows["included"].to_numpy(dtype=bool)
    steps = tuple(
        Step(int(trial), float(at), float(db), str(said), bool(good), place in turned)
        for place, (trial, at, db, said, good) in enumerate(
            zip(rows["trial"], level, x, rows["answered"], right, strict=True)
        )
        if kept[place]
    )
    guess = 0.5 if own.intervals == 2 else caught.false_alarms / max(caught.trials, 1)
    estimate = threshold_by_rule(x, right, turned, planned.levels, kept)
    by_level = tuple(_at_level(rows[kept & (level == at)], caught, own) for at in sorted(set(level[kept].tolist())))
    fitted, statement, at_share = None, "", None
    try:
        if guess == 1:
            raise NotDefined("a psychometric function needs a catch trial that was not answered yes")
        counts = np.array([(one.x_db, one.right, one.trials) for one in by_level]).T
        fitted = fit(*counts, guess=guess)
        at_share = _where(fitted, estimate.share)
    except NotDefined as error:
        statement = str(error)
    beyond = beyond_grid(x[kept], right[kept], planned.levels, estimate.share)
    if beyond:
        estimate = replace(estimate, db=None, sd=None, statement=f"the threshold is {beyond}")
    limits = None if own.intervals == 2 or not caught.trials else _exact_limits(caught)
    table = protocol.kind_table(planned)
    numbers, peak = table.numbers.get(signal, {}), table.peaks_m_s2.get(signal)
    frequency_hz = numbers["frequency_hz"] if set(numbers) == TONE else None
    found = estimate, guess, fitted, at_share, statement, frequency_hz, beyond, limits
    return Track(caught.participant, signal, peak, steps, by_level, *found)


def beyond_grid(x: Floats, right: np.ndarray, levels: Levels | None, share: float | None) -> Beyond:
    """Return where the threshold is of a track that stayed at an end of its grid, from levels x, dB, and right answers.

    Both have the shape (trials,). It is above the highest level where the later half of the trials was mostly there and
    fewer were right than the `share` that the levels aim at; below the lowest where more were.
    """
    if levels is None or share is None or not len(x):
        return ""
    late, good = x[len(x) // 2 :], right[len(x) // 2 :]
    low, high = (np.isclose(late, 20 * np.log10(levels.grid[end])) for end in (0, -1))
    if high.mean() > STAYED and good[high].mean() < share:
        return "above the highest level"
    return "below the lowest level" if low.mean() > STAYED and good[low].mean() > share else ""


def _exact_limits(caught: Catches) -> tuple[float, float]:
    """Return the 95 % limits of the share of yes (Clopper and Pearson 1934, Biometrika 26, 404-413)."""
    limits = binomtest(caught.false_alarms, caught.trials).proportion_ci(CONFIDENCE)
    return float(limits.low), float(limits.high)


def _where(of: Fit, share: float | None) -> float | None:
    """Return at how many dB the fitted function has a share of right answers, by its medians."""
    if share is None or not 0 < (felt := (share - of.guess) / (1 - of.guess - of.lapse.value)) < 1:
        return None
    return of.threshold.value + of.spread.value * float(ndtri(felt))


def _at_level(rows: pd.DataFrame, caught: Catches, own: Detection) -> AtLevel:
    lead = rows[rows["lead"]]
    hits, signals = int(lead["claimed"].sum()), len(lead)
    alarms, others = caught.false_alarms, caught.trials
    if own.intervals == 2:
        other = rows[~rows["lead"]]
        alarms, others = int(other["claimed"].sum()), len(other)
    try:
        d = sensitivity(hits, signals, alarms, others, RULES[own.intervals])
    except NotDefined:
        d = None
    right = int((rows["lead"] == rows["claimed"]).sum())
    x_db = 20 * float(np.log10(rows["level"].fillna(1.0).iloc[0]))
    return AtLevel(x_db, right, len(rows), hits, signals, alarms, others, d)


def reversals(right: Sequence[bool], levels: Levels | None) -> tuple[int, ...]:
    """Return the places of the trials after which an up-down track turned; none of other methods (Levitt 1971)."""
    if levels is None or levels.down is None:
        return ()
    turned, run, way = [], 0, 0
    for place, good in enumerate(right):
        run = run + 1 if good else 0
        if good and run < levels.down:
            continue
        new, run = (-1 if good else 1), 0
        if way == -new:
            turned.append(place)
        way = new
    return tuple(turned)


def threshold_by_rule(
    x: Floats, right: np.ndarray, turned: Sequence[int], levels: Levels | None, kept: np.ndarray
) -> Estimate:
    """Return the threshold by the rule of the levels, from levels x in dB and right answers, each of shape (trials,).

    `turned` are the places of reversals; of the trials only those `kept`, shape (trials,), count.
    Of an up-down track, the mean of the levels at its reversals with the last step, of which an even number, the last,
    count (Levitt 1971): it is where p^down = up / (up + 1) are right. Of `quest-plus` and `psi`, mean and standard
    deviation of the posterior on the protocol's own thresholds, spreads and lapses.
    """
    if levels is None or levels.method == "constant":
        return Estimate("constant" if levels else "one level", None, None, None)
    if levels.down is not None:
        up = levels.up or 1
        share = (up / (up + 1)) ** (1 / levels.down)
        last = [place for place in turned[len(levels.steps or (1,)) - 1 :] if kept[place]]
        last = last[len(last) % 2 :]
        if not last:
            return Estimate("reversals", None, None, share, "too few reversals with the last step")
        at = x[last]
        return Estimate("reversals", float(at.mean()), float(at.std(ddof=1)), share)
    t, x, right = 20 * np.log10(np.asarray(levels.thresholds)), x[kept], right[kept]
    guess, log = levels.guess or 0.0, np.zeros((len(t), len(levels.spreads_db or ()), len(levels.lapses or ())))
    for i, at in enumerate(t.tolist()):
        for j, spread in enumerate(levels.spreads_db or ()):
            for k, lapse in enumerate(levels.lapses or ()):
                share = np.clip(psychometric(x, at, spread, guess, lapse), 1e-12, 1 - 1e-12)
                log[i, j, k] = np.log(np.where(right, share, 1 - share)).sum()
    known = np.exp(log - log.max())
    known /= known.sum()
    weight, lapse = known.sum(axis=(1, 2)), float(known.sum(axis=(0, 1)) @ np.asarray(levels.lapses))
    center = float(weight @ t)
    return Estimate("posterior", center, float(np.sqrt(weight @ (t - center) ** 2)), guess + (1 - guess - lapse) / 2)
