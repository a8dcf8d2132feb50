"""What an accelerometer heard of the stimuli of a study, beside what was sent, by task and material."""

import numpy as np
import pandas as pd

from palpate.analysis.documents.tables import Column, Record, Section, Table, tabulate
from palpate.analysis.reading.study import Study
from palpate.experiment.synthesis.noticing import THIRDS_HZ

UNHEARD = (
    "The rig has no loopback, so nothing measured what reached the panel. A stimulus counts as undelivered only if "
    "its audio stream reported a fault."
)

UNLISTENED = (
    "This dataset has no comparison of sent and measured vibration. A dataset has one if the rig's panel was measured "
    "and its accelerometer stays on it."
)

LEAST_SHARE = 1e-3
"""A third octave with less of the energy sent than this does not count."""

NOTE = (
    '"Sent" is the panel\'s movement, computed from the samples and the panel\'s measured response. "Heard" is '
    "all that its accelerometer measured around an attempt's last stimulus, including the impact of foot or hand. "
    "Each pair of columns shows the median, then the worst. Peak: ratio of heard to sent. Third octaves: the "
    f"largest deviation in each stimulus, among those from 10 to 500 Hz with {LEAST_SHARE:.1%} or more of the energy "
    "sent, and the frequency of the worst. Delay: from sent to heard, including the latencies of both ports."
)


def heard_tables(study: Study, attempts: pd.DataFrame) -> tuple[Table, ...]:
    """Return what was heard in these attempts beside what was sent, or nothing where nothing listened."""
    whole = attempts[["heard_thirds", "sent_thirds"]].notna().all(axis=1)
    known = attempts[whole & (attempts["heard_peak_m_s2"] > 0) & (attempts["sent_peak_m_s2"] > 0)]
    records = [
        _record(task.id, material, rows)
        for task in study.tasks
        for material in study.materials
        if not (rows := known[(known["task"] == task.id) & (known["heard_of"] == material)]).empty
    ]
    title = f"Vibration measured by an accelerometer and vibration sent, in {len(known)} of {len(attempts)} attempts"
    return (tabulate(title, HEARD, records, (NOTE,)),) if records else ()


def heard_sections(study: Study) -> tuple[Section, ...]:
    """Return the section of what was heard, of participants analysed, or none where nothing listened."""
    tables = heard_tables(study, study.of_analysed())
    return (Section("heard", "What was heard", (), tables),) if tables else ()


def _decibels(value: float | None) -> str:
    return "-" if value is None else f"{value:+.2f}"


HEARD = (
    Column("task", left=True), Column("presented", left=True), Column("heard"),
    Column("sent_peak_m_s2_median", "peak sent (m/s^2)"),
    Column("peak_db_median", "peak, dB", show=_decibels), Column("peak_db_worst", "worst", show=_decibels),
    Column("third_octave_db_median", "third octave, dB", 2), Column("third_octave_db_worst", "worst", 2),
    Column("third_octave_hz_worst", "at Hz", 0),
    Column("delay_ms_median", "delay, ms", 1), Column("delay_ms_worst", "worst", 1),
)  # fmt: skip


def _record(task: str, material: str, rows: pd.DataFrame) -> Record:
    peaks_db = 20 * np.log10((rows["heard_peak_m_s2"] / rows["sent_peak_m_s2"]).to_numpy(np.float64))
    sent, heard = (np.array(rows[column].tolist(), dtype=np.float64) for column in ("sent_thirds", "heard_thirds"))
    energies = 10 ** (sent / 10)
    counts = energies >= LEAST_SHARE * energies.sum(axis=1, keepdims=True)
    off_db = np.where(counts, np.abs(heard - sent), 0.0)
    worst_db = off_db.max(axis=1)
    delays_ms = rows["heard_delay_s"].dropna() * 1e3
    return {
        "task": task,
        "presented": material,
        "heard": len(rows),
        "sent_peak_m_s2_median": float(rows["sent_peak_m_s2"].median()),
        "peak_db_median": float(np.median(peaks_db)),
        "peak_db_worst": float(peaks_db[np.abs(peaks_db).argmax()]),
        "third_octave_db_median": float(np.median(worst_db)),
        "third_octave_db_worst": float(worst_db.max()),
        "third_octave_hz_worst": float(THIRDS_HZ[int(off_db[worst_db.argmax()].argmax())]),
        "delay_ms_median": None if delays_ms.empty else float(delays_ms.median()),
        "delay_ms_worst": None if delays_ms.empty else float(delays_ms.max()),
    }
