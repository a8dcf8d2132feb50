"""TDMS, as LabVIEW and DAQExpress write it: each channel with the increment and the unit that it states."""

import io
import struct

import numpy as np

from palpate.experiment.errors import RecordingError
from palpate.experiment.recordings.formats.interface import Channel, Format, Step, channels_of, needed, refuse_large
from palpate.experiment.settings.units import SECONDS, Heading, is_clock, time_unit

NAME = "TDMS"


def read(content: bytes) -> tuple[list[Channel], str]:
    """Return the channels of a file, and whether its recorder ended before it was whole.

    Raises `RecordingError` for one that is damaged or too large.
    """
    tdms = needed("nptdms", NAME)
    try:
        layout = tdms.TdmsFile.read_metadata(io.BytesIO(content))
        refuse_large((len(one) for group in layout.groups() for one in group.channels()), NAME)
        file = tdms.TdmsFile.read(io.BytesIO(content))
    except (ValueError, KeyError, EOFError, OverflowError, NotImplementedError, struct.error) as error:
        raise RecordingError(
            f"the {NAME} file is damaged ({error})", remedy="export it again", allowed="an undamaged file"
        ) from error
    groups = file.groups()
    found: list[Channel] = []
    for group in groups:
        for one in group.channels():
            name = one.name if len(groups) == 1 else f"{group.name}/{one.name}"
            step = one.properties.get("wf_increment", np.nan)
            over, x_unit = (str(one.properties.get(key) or "") for key in ("wf_xname", "wf_xunit_string"))
            unit_s = SECONDS.get(time_unit(Heading(over, x_unit or "s")), np.nan)
            step_s = float(step) * unit_s if isinstance(step, int | float) and step > 0 else np.nan
            dimension = "Time" if is_clock(over or "time") and unit_s > 0 else over or x_unit
            unit = str(one.properties.get("unit_string") or one.properties.get("NI_UnitDescription") or "")
            channels = channels_of(name, np.asarray(one[:]), unit, Step(step_s))
            found += [channel._replace(dimension=dimension) for channel in channels]
    cut = file.file_status.incomplete_final_segment
    return found, f"the {NAME} file is incomplete: its last segment is cut off" if cut else ""


FORMAT = Format(NAME, (b"TDSm",), read)
