"""The floor by thresholds that were measured at the participants' own skin: what they did not feel is below it.

The file is `thresholds.csv` of `palpate export` of a study of detection whose signals are sinusoids, such as
`protocols/sole.toml`. Its column `floor_rms_m_s2` has the lower limit of the 95 % of each threshold, m/s^2 rms.
"""

import csv
import math
from collections.abc import Mapping

from palpate.experiment.errors import ProtocolError, mismatch
from palpate.experiment.protocol import files
from palpate.experiment.protocol.kinds.footstep import Footstep, Measured
from palpate.experiment.protocol.models import Protocol

COLUMNS = ("dataset", "participant", "frequency_hz", "floor_rms_m_s2")
MEASURED = "measured"
"""What the first column has of a dataset that nobody simulated."""


def floor_m_s2(protocol: Protocol, participant: str | None) -> float:
    """Return the rms below which a participant, or None for everybody, feels nothing at any frequency measured, m/s^2.

    It is the least of all participants' lower limits, or of the participant's own, but never above
    `footstep.tactile.floor_m_s2`. Of each participant's own, that for None is the largest, by which most is left out.

    Raises `ProtocolError` for a file that is gone, another, or without thresholds, and for a participant without any.
    """
    least, measured = least_m_s2(protocol), _measured(protocol)
    most = protocol.table(Footstep).tactile.floor_m_s2
    if measured.whose == "everybody":
        return min(most, *least.values())
    if participant is None:
        return min(most, max(least.values()))
    if participant not in least:
        allowed = f"one with a threshold in {measured.file}: {', '.join(least)}"
        raise ProtocolError.in_file(
            protocol.folder / measured.file, [mismatch("participant", None, participant, allowed)]
        )
    return min(most, least[participant])


def least_m_s2(protocol: Protocol) -> Mapping[str, float]:
    """Return the least lower limit of each participant's thresholds, m/s^2 rms. Raises as `floor_m_s2`."""
    least: dict[str, float] = {}
    for row in _rows(protocol):
        try:
            floor = float(row["floor_rms_m_s2"])
        except ValueError:
            continue
        if math.isfinite(floor) and floor > 0:
            who = row["participant"].removeprefix("sub-")
            least[who] = min(floor, least.get(who, math.inf))
    if not least:
        raise _unusable(protocol, "no floor_rms_m_s2 above 0")
    return least


def refuse_simulated(protocol: Protocol) -> None:
    """Raise `ProtocolError` for thresholds of a dataset that was not measured, which are no participants' own."""
    if of := {row["dataset"] for row in _rows(protocol)} - {MEASURED}:
        raise _unusable(protocol, "; ".join(sorted(of)))


def _measured(protocol: Protocol) -> Measured:
    if (found := protocol.table(Footstep).tactile.measured) is None:
        problem = mismatch("footstep.tactile.measured", None, "no such table", "one that names thresholds")
        raise ProtocolError.in_file(f"study {protocol.study.id}", [problem])
    return found


def _rows(protocol: Protocol) -> list[dict[str, str]]:
    try:
        text = files.companion(protocol, _measured(protocol).file).decode("utf-8")
    except UnicodeDecodeError:
        raise _unusable(protocol, "a file that is not UTF-8") from None
    rows = list(csv.DictReader(text.splitlines()))
    if not rows or not set(COLUMNS) <= set(rows[0]) or any(None in [*row, *row.values()] for row in rows):
        raise _unusable(protocol, "another table")
    return rows


def _unusable(protocol: Protocol, got: str) -> ProtocolError:
    allowed = f"thresholds.csv of palpate export, with {', '.join(COLUMNS)}, of a study of sinusoids"
    return ProtocolError.in_file(protocol.folder / _measured(protocol).file, [mismatch("file", None, got, allowed)])
