"""What `import palpate` hands out: functions for notebooks and scripts, each of which returns one value.

Nothing here draws a figure or writes a file. A value has `to_frame()`, a pandas DataFrame, and a short `repr`. What is
raised is a `PalpateError` of `palpate.experiment.errors`.
"""

from __future__ import annotations

import warnings
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from palpate.analysis.audit.audit import Audit
    from palpate.analysis.designs.comparison.results import Compared
    from palpate.analysis.designs.detection.results import Detections
    from palpate.analysis.designs.rating.results import Ratings
    from palpate.analysis.identification.results import Results
    from palpate.analysis.power.simulate import Power
    from palpate.analysis.reading.study import Study
    from palpate.experiment.recordings.spectrum import AmplitudeSpectrum
    from palpate.experiment.synthesis.contact.path import Trajectory
    from palpate.experiment.synthesis.waveforms import Stimulus

    PathLike = str | os.PathLike[str]


def read(dataset: PathLike, *others: PathLike) -> Study:
    """Read a dataset, or several as one.

    Parameters
    ----------
    dataset, *others
        Folders of datasets that palpate made. Those with journals are verified first, as `palpate analyse` does; open
        sessions, and tables without a journal, are warned of.

    Returns
    -------
    Study
        Materials, tasks and participants; `to_frame()` has one row for each trial that counts.

    Raises
    ------
    DatasetError
        A folder is no dataset, or something in it is missing, damaged or changed.

    Examples
    --------
    >>> import palpate
    >>> study = palpate.read("participants/okamoto2012")
    >>> study
    <Study okamoto2012, RECONSTRUCTION: 15 participants; virtual, real; 1000 trials, 0 left out>
    >>> trials = study.to_frame()
    >>> (trials["presented"] == trials["answered"]).groupby(trials["task"], sort=False).mean().round(3).to_dict()
    {'virtual': 0.53, 'real': 0.648}
    """
    from palpate.analysis.reading.pooled import read_pooled
    from palpate.experiment.dataset.tables import check_analysed

    folders = [Path(one) for one in (dataset, *others)]
    for folder in folders:
        for line in check_analysed(folder):
            warnings.warn(line, stacklevel=2)
    return read_pooled(folders)


def identify(study: Study | PathLike) -> Results:
    """Analyze the answers of an identification study, without its controls: Tables 1 and 2, their tests and models.

    Parameters
    ----------
    study
        What `read` returned, or a dataset's folder.

    Returns
    -------
    Results
        `to_frame()` has one row for each task, presented and answered material, "(none)" where nothing was answered, as
        categories in the order of the tables: the mean ratio among participants,
        their standard deviation (n - 1), and of right answers the t-test against chance, P unadjusted and by Holm's
        method.

    Raises
    ------
    DatasetError
        As `read`; the study has no trial that counts, or consists of comparisons.

    Examples
    --------
    >>> import palpate
    >>> results = palpate.identify("participants/okamoto2012")
    >>> cells = results.to_frame().set_index(["task", "presented", "answered"])
    >>> cells.loc[("virtual", "aluminum foil", "aluminum foil"), ["t", "p"]].round(3).to_dict()  # as printed
    {'t': 2.753, 'p': 0.016}
    """
    found: Results = _results(study, "identification")
    return found


def compare(study: Study | PathLike) -> Compared:
    """Analyze the answers of a study of paired comparisons: shares of right choices, and scales.

    Parameters
    ----------
    study
        What `read` returned, or a dataset's folder.

    Returns
    -------
    Compared
        `to_frame()` has one row for each task and pair of materials: right choices, trials, ties, and the exact 95 %
        interval of their share.

    Raises
    ------
    DatasetError
        As `read`; the study has no trial that counts, or identifies materials.
    """
    found: Compared = _results(study, "comparison")
    return found


def rate(study: Study | PathLike) -> Ratings:
    """Analyze the answers of a study of ratings: means, agreement of participants, power laws.

    Parameters
    ----------
    study
        What `read` returned, or a dataset's folder.

    Returns
    -------
    Ratings
        `to_frame()` has one row for each task and material: its magnitude, trials, participants, their mean rating with
        its standard deviation and 95 % interval.

    Raises
    ------
    DatasetError
        As `read`; the study has no trial that counts, or is no study of ratings.
    """
    found: Ratings = _results(study, "rating")
    return found


def detect(study: Study | PathLike) -> Detections:
    """Analyze the answers of a study of detection: thresholds by the rule of the levels and by fits, and d'.

    Parameters
    ----------
    study
        What `read` returned, or a dataset's folder.

    Returns
    -------
    Detections
        `to_frame()` has one row for each task, participant and signal: its trials, reversals and both thresholds in dB
        above level 1, with the interval of the fitted one; `steps()` one for each trial of a track.

    Raises
    ------
    DatasetError
        As `read`; the study has no trial that counts, is no study of detection, or has no protocol in it.
    """
    found: Detections = _results(study, "detection")
    return found


def audit(target: PathLike, against: PathLike | None = None) -> Audit:
    """Hold a paper's printed numbers against one another, or against a dataset.

    Parameters
    ----------
    target
        The id of a study that palpate brings along, a file of printed numbers (TOML), a paper's tables (HTML, CSV), or
        a dataset's folder.
    against
        The file of a dataset's paper; by default it is found by the study's id.

    Returns
    -------
    Audit
        `to_frame()` has one row for each printed number, with the recomputed one and the verdict.

    Raises
    ------
    PublishedError
        A file cannot be used.
    DatasetError
        A dataset cannot be read, or no paper belongs to it.

    Examples
    --------
    >>> import palpate
    >>> palpate.audit("okamoto2012")
    <Audit okamoto2012: 117 agrees, 10 differs, 4 agrees if truncated, 1 impossible, 1 cannot be decided>
    """
    from palpate.analysis.audit import audit as audits

    return audits.audit(str(target), None if against is None else Path(against))


def power(
    protocol: PathLike,
    *,
    participants: Sequence[int] = (5, 10, 15, 20, 30),
    model: str = "published",
    studies: int = 1000,
    alpha: float | None = None,
    target: float = 0.8,
    seed: int = 1,
    jobs: int = 1,
    progress: bool = False,
) -> Power:
    """Simulate whole studies, and count how often each planned test shows what it asks.

    Parameters
    ----------
    protocol
        A protocol file, or the id of a shipped one.
    participants
        Numbers of participants to try.
    model
        How simulated participants answer: "published" (as in the tables of this study), another study's id, a
        dataset's folder, a TOML file, or two numbers, "0.8,0.15": how often right, and their intraclass correlation.
    studies
        Simulated studies of each size.
    alpha
        Level of every test; by default each test's own.
    target
        The power to reach, between 0 and 1.
    seed
        Names every random draw.
    jobs
        Processes; 0 means one for each core.
    progress
        Whether a bar on standard error shows how far it is.

    Returns
    -------
    Power
        SIMULATED. `to_frame()` has one row for each question, model and number of participants: power with the limits
        of its Monte Carlo error (95 %, Wilson).

    Raises
    ------
    PowerError
        A number is out of bounds, or the model does not fit the protocol.
    PalpateError
        There is no such protocol, or it is broken.
    """
    from palpate.analysis.power import simulate
    from palpate.experiment.cli import options
    from palpate.experiment.protocol import files

    study = files.load(files.named(str(protocol)))
    planned, chosen = simulate.prepare(study, model, alpha)
    with options.progress(simulate.LABEL, quiet=not progress) as (total, tick):
        return simulate.run(
            study,
            planned,
            chosen,
            participants=participants,
            studies=studies,
            seed=seed,
            target=target,
            runner=partial(simulate.on_cores, jobs=jobs),
            total=total,
            tick=tick,
        )


def spectrum(
    file: PathLike,
    *,
    channel: str | int | None = None,
    encoding: str | None = None,
    decimal: str | None = None,
    time_unit: str | None = None,
    time_column: str | None = None,
    axes: Sequence[str | int] | None = None,
    reduction: Literal["dft321", "norm"] = "dft321",
    resample: bool = False,
    rate: float | None = None,
) -> AmplitudeSpectrum:
    """Read one channel of a recording, and return its amplitude spectrum. What is doubtful in the file is warned of.

    Where an error names an option of the command, such as `--time-unit ms`, it is here the argument of that name.

    Parameters
    ----------
    file
        A WAV file, text with a column of times, a LabVIEW file (.lvm, .tdms), a MATLAB file (.mat) or one of HDF5.
    channel
        Its name, or its number from 1; by default the first that holds no times and counts no samples.
    encoding
        The code page of a text file that is not UTF-8 or UTF-16.
    decimal
        The decimal sign of a text file that does not say: a point or a comma.
    time_unit
        The unit of the times of a text file that does not say: s, ms, us, ns, min, h or d.
    time_column
        The name of the column of times, where it does not say so or there are several.
    axes
        Names or numbers of channels that are the axes of one sensor and become one, in place of `channel`.
    reduction
        How they do: ``"dft321"`` has the power of all at each frequency, ``"norm"`` is the length of the acceleration.
    resample
        Whether samples at uneven times are brought onto an even grid, by a cubic spline whose error is warned of.
    rate
        The sampling rate of a file without times, Hz.

    Returns
    -------
    AmplitudeSpectrum
        `to_frame()` has the columns frequency_hz and amplitude, the latter in the recording's unit.

    Raises
    ------
    RecordingError
        The file cannot be read, has no such channel, or is too short.
    PalpateError
        `decimal` is neither a point nor a comma, or `rate` is not above 0.
    """
    from palpate.experiment.recordings.readers import Axes
    from palpate.experiment.recordings.spectrum import of_file
    from palpate.experiment.settings.delimited import Stated

    named = None if channel is None else str(channel)
    made_of = None if axes is None else Axes(tuple(map(str, axes)), reduction)
    stated = Stated(encoding, decimal, time_unit, time_column, resample=resample, rate_hz=rate)
    found = of_file(Path(file), channel=named, axes=made_of, stated=stated)
    for doubt in found.recording.doubts:
        warnings.warn(doubt.sentence(), stacklevel=2)
    return found


def crinkle(recordings: PathLike, material: str, speed_mm_s: float, *, rate_hz: int | None = None) -> Stimulus:
    """Synthesize the vibration of a material that is stepped on: Okamoto et al., section 3.1, equations (2) to (4).

    Parameters
    ----------
    recordings
        A folder of takes, as `palpate record` writes it.
    material
        The material's id.
    speed_mm_s
        The foot's speed, mm/s, zero or more.
    rate_hz
        Sampling rate of the waveform; by default that of the recordings.

    Returns
    -------
    Stimulus
        `waveform_m_s2`, shape (n,); `to_frame()` has the columns time_s and acceleration_m_s2.

    Raises
    ------
    RecordingError
        The folder cannot be read, or has no takes of the material.
    SynthesisError
        The speed or the rate is not allowed.
    """
    from palpate.experiment.recordings import manifest
    from palpate.experiment.synthesis import waveforms

    takes = manifest.load_all(Path(recordings))
    spectra, output_hz = takes.spectra(material), takes.rate_hz if rate_hz is None else rate_hz
    return waveforms.prepare(spectra, material=material, output_rate_hz=output_hz).at(speed_mm_s)


def contact(
    times_s: ArrayLike,
    height_m: ArrayLike,
    *,
    stiffness_n_m: float,
    damping_n_s_m: float = 0.0,
    mass_kg: float | None = None,
) -> Trajectory:
    """Push a hand into a visco-elastic block, and return the force that it feels: Wellman and Howe, equation (6).

    Parameters
    ----------
    times_s
        Times of the samples, s, rising, shape (n,). Between them the hand moves straight at constant speed.
    height_m
        The hand's height above the block's face, m, shape (n,); it begins at zero or above.
    stiffness_n_m, damping_n_s_m
        K, N/m, and C, N s/m, along the normal.
    mass_kg
        The block's mass, kg; None for a block that is held.

    Returns
    -------
    Trajectory
        `to_frame()` has the columns time_s, x_m (the height), y_m, x_n (the force that pushes the hand out) and y_n.

    Raises
    ------
    SynthesisError
        Shapes differ, times do not rise, or a number is not allowed.

    Examples
    --------
    A hand that goes 1 mm deep at 0.1 m/s into a spring of 500 N/m feels 0.5 N there.

    >>> import palpate
    >>> touch = palpate.contact([0.0, 0.01, 0.02], [0.001, 0.0, -0.001], stiffness_n_m=500.0)
    >>> touch.to_frame()["x_n"].round(12).to_list()
    [0.0, 0.0, 0.5]
    """
    import numpy as np

    from palpate.experiment.errors import SynthesisError
    from palpate.experiment.synthesis.contact.block import Block
    from palpate.experiment.synthesis.contact.path import trajectory

    heights = np.asarray(height_m, dtype=np.float64)
    if heights.ndim != 1:
        raise SynthesisError(f"got height_m of shape {heights.shape}", remedy="give one height for each time")
    mass = float("inf") if mass_kg is None else mass_kg
    block = Block((stiffness_n_m, 0.0), (damping_n_s_m, 0.0), (mass, mass), into=(-1.0, 0.0))
    return trajectory((block,), times_s=times_s, hand_m=np.stack([heights, np.zeros_like(heights)], axis=-1))


def _results(study: Study | PathLike, design: str) -> Any:
    from palpate.analysis import designs, published
    from palpate.analysis.conditions import control
    from palpate.analysis.reading.dataset import silent
    from palpate.analysis.reading.study import Study

    given, _ = control.apart(study if isinstance(study, Study) else read(study))
    designs.check_design(given, design)
    return designs.named(design).compute(given, published.load(given.id), None, silent)
