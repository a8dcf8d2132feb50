"""The floor by thresholds that were measured at the participants' own skin: what they did not feel is below it.

The file is `thresholds.csv` of `palpate export` of a study of detection whose signals are sinusoids, such as
`protocols/sole.toml`. Its column `floor_rms_m_s2` has the lower limit of the 95 % of each threshold, m/s^2 rms.
"""

import csv
import math
import re
from collections.abc import Mapping

from palpate.experiment.errors import ProtocolError, mismatch
from palpate.experiment.protocol import files
from palpate.experiment.protocol.kinds.footstep import Footstep, Measured
from palpate.experiment.protocol.models import Protocol

COLUMNS = ("dataset", "participant", "frequency_hz", "floor_rms_m_s2", "beyond")
NUMBER = re.compile(r"[0-9]+\.?[0-9]*(e[+-]?[0-9]+)?")
MEASURED = "measured"
"""What the first column has of a dataset that nobody simulated."""


def floor_m_s2(protocol: Protocol, participant: str | None) -> float:
    """Return the rms below which a participant, or None for everybody, feels nothing at any frequency measured, m/s^2.

    It is the least of all participants' lower limits, or of the participant's own, but never above
    `footstep.tactile.floor_m_s2`. Of each participant's own, that for None is the largest, by which most is left out.

    Raises `ProtocolError` for a file that is gone, another, or without thresholds, and for a participant without any.
    """
    least, measured = least_m_s2(protocol), _measured(protocol)
    if measured.whose == "everybody" or participant is None:
        return range_m_s2(protocol)[1]
    if participant not in least:
        allowed = f"a participant with known thresholds in {measured.file}: {', '.join(least)}"
        problem = mismatch("participant", None, participant, allowed)
        raise ProtocolError.in_file(protocol.folder / measured.file, [problem])
    return min(protocol.table(Footstep).tactile.floor_m_s2, least[participant])


def range_m_s2(protocol: Protocol) -> tuple[float, float]:
    """Return the least and the largest floor that any participant has, m/s^2 rms. Raises as `floor_m_s2`."""
    least, most = sorted(least_m_s2(protocol).values()), protocol.table(Footstep).tactile.floor_m_s2
    return min(most, least[0]), min(most, least[0 if _measured(protocol).whose == "everybody" else -1])


def least_m_s2(protocol: Protocol) -> Mapping[str, float]:
    """Return the least lower limit of each participant's thresholds, m/s^2 rms. Raises as `floor_m_s2`.

    Who may have felt less than any level, or whose threshold is not known, has none; of everybody's, nobody has.
    """
    least, unknown = dict[str, float](), dict[str, str]()
    for row in _rows(protocol):
        cell, who = row["floor_rms_m_s2"], row["participant"].removeprefix("sub-")
        if NUMBER.fullmatch(cell) and (floor := float(cell)) > 0:
            least[who] = min(floor, least.get(who, math.inf))
        elif NUMBER.fullmatch(row["frequency_hz"]) and row["beyond"] != "above the highest level":
            unknown[who] = f"{row['beyond'] or 'no threshold'} for {who} at {row['frequency_hz']} Hz"
    known = {who: floor for who, floor in least.items() if who not in unknown}
    if not known or (unknown and _measured(protocol).whose == "everybody"):
        raise _unusable(protocol, "; ".join(unknown.values()) or "no floor_rms_m_s2 above 0")
    return known


def refuse_simulated(protocol: Protocol) -> None:
    """Raise `ProtocolError` for thresholds of a dataset that was not measured, which are no participants' own."""
    if of := {row["dataset"] for row in _rows(protocol)} - {MEASURED}:
        raise _unusable(protocol, "; ".join(sorted(of)))


def _measured(protocol: Protocol) -> Measured:
    if (found := protocol.table(Footstep).tactile.measured) is None:
        problem = mismatch("footstep.tactile.measured", None, "none", "a table that gives thresholds")
        raise ProtocolError.in_file(f"study {protocol.study.id}", [problem])
    return found


def _rows(protocol: Protocol) -> list[dict[str, str]]:
    try:
        text = files.companion(protocol, _measured(protocol).file).decode("utf-8")
    except UnicodeDecodeError:
        raise _unusable(protocol, "text that is not UTF-8") from None
    rows = list(csv.DictReader(text.splitlines()))
    if not rows or not set(COLUMNS) <= set(rows[0]) or any(None in [*row, *row.values()] for row in rows):
        raise _unusable(protocol, "a different table")
    return rows


def _unusable(protocol: Protocol, got: str) -> ProtocolError:
    allowed = f"thresholds.csv from `palpate export` for a study of sinusoids, with the columns {', '.join(COLUMNS)}"
    return ProtocolError.in_file(protocol.folder / _measured(protocol).file, [mismatch("file", None, got, allowed)])
