"""What a rig makes of the stimuli that a protocol declares: peak, seconds and what it leaves out; and which it may not
play."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import numpy as np

from palpate.experiment.apparatus.panel.conditioning import Conditioner, open_conditioner, open_drive
from palpate.experiment.apparatus.panel.validity import refuse_unmeasured
from palpate.experiment.apparatus.rig import Rig, check_age
from palpate.experiment.errors import Finding, PalpateError, RecordingError, Remedy, RigError
from palpate.experiment.protocol.kinds.presented import Presented
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.session.kinds.presented.stimuli import Recording, peak_m_s2, recording, rendered
from palpate.experiment.synthesis.signals import waves

UNKNOWN = "the frequencies that its actuator carries were not measured"

LEFT_S = 0.05
"""A recording that goes on for longer may have been meant whole; ours."""

LEAST_HZ = 2000
"""Twice the highest frequency of vibrotactile thresholds (Verrillo 1963, J. Acoust. Soc. Am. 35, 1962-1966)."""

SHOWN = 5e-6
"""A share is told from here on: 0.0005 %."""


@dataclass(frozen=True)
class Made:
    """What a rig makes of the stimulus of a material at its site, as a session would hand it over.

    `asked_m_s2` is the peak that is declared, `reached_m_s2` the panel's at most, by its measured response. Shares are
    of the rms: `left_out` of what it does not carry, `off` of all that differs. `limited`: a limit changes it. The last
    three are those of `synthesis.budget.Budget`, of an inverse.
    """

    material: str
    lasts_s: float
    asked_m_s2: float
    reached_m_s2: float
    left_out: float
    off: float
    limited: bool
    before: float
    gain: float
    gain_hz: float
    site: str | None = None

    @property
    def words(self) -> str:
        """The same in words."""
        out = f"{self.left_out:.2%} (rms) left out" if self.left_out >= SHOWN else "nothing left out"
        peak = f"peak at most {self.reached_m_s2:.3g} m/s^2 of {self.asked_m_s2:.3g} requested"
        gain = f"{self.off:.1%} error because the inverse has a gain of {self.gain:.3g} at {self.gain_hz:.0f} Hz"
        inverse = f", {gain}, which moves the panel by {self.before:.1%} before onset" if self.gain else ""
        limited = ", reduced by a limit" if self.limited else ""
        at = "" if self.site is None else f" at {self.site}"
        return f"{self.material}{at}: {self.lasts_s:g} s, {peak}, {out}{inverse}{limited}"


def on_rig(*, protocol: Protocol, rig: Rig, rig_folder: Path) -> tuple[Made, ...]:
    """Return what a rig makes of every stimulus of a study. Raises as `rendered` and `conditioning.open_drive`."""
    table, conditions = protocol.table(Presented), dict[str | None, Conditioner]()
    for site, own in sites(protocol, rig).items():
        limit_m_s2 = protocol.limits_m_s2[site]
        drive = open_drive(rig_folder, own.actuator, limit_m_s2=limit_m_s2)
        conditions[site] = open_conditioner(own, limit_m_s2=limit_m_s2, drive=drive)
    found = []
    for material, stimulus in rendered(protocol, rig.actuator.rate_hz).items():
        site = table.site_of[material]
        played = conditions[site](stimulus)
        kept, (error, _) = played.on_record(), played.budget()
        found.append(
            Made(
                material,
                kept.lasts_s,
                peak_m_s2(stimulus),
                kept.reached_peak_m_s2,
                kept.computed.left_out or 0.0,
                kept.computed.relative_error,
                limited=bool(played.limited) or played.scale < 1 or played.panel_scale < 1,
                before=error.before,
                gain=error.gain,
                gain_hz=error.gain_hz,
                site=site,
            )
        )
    return tuple(found)


def refusals(protocol: Protocol, rig: Rig, every: tuple[Made, ...]) -> Iterator[Finding]:
    """Yield why no participant is run on a rig that makes this of the stimuli."""
    where = f"rig '{rig.rig.name}'"
    for one in every:
        if one.limited:
            _, limit = _limit(protocol, one.site)
            yield Finding(
                f"a limit changes a stimulus ({one.words})",
                where,
                allowed=f"one within {limit} and the rig's full scale",
                remedy="lower its amplitude in the protocol",
            )
    most = protocol.table(Presented).left_out_max
    if most is None:
        return
    if not is_known(protocol, rig):
        remedy: Remedy | str = "measure the panel, and write actuator.low_hz and high_hz into the rig file"
        yield Finding(UNKNOWN, where, allowed="a measured band (presented.left_out_max)", remedy=remedy)
    for one in every:
        if one.left_out > most:
            allowed = f"{100 * most:.6g} % left out (presented.left_out_max)"
            yield Finding(
                f"got {one.words}", where, allowed=allowed, remedy="present stimuli that this rig can reproduce"
            )


def _limit(protocol: Protocol, site: str | None) -> tuple[float, str]:
    """Return the largest acceleration at a site, m/s^2, and the key that says so."""
    most = protocol.limits_m_s2[site]
    return most, f"the peak_m_s2 of {site} ({most:g})" if site else f"exposure.vibration_peak_m_s2 ({most:g})"


def is_known(protocol: Protocol, rig: Rig) -> bool:
    """Return whether somebody measured which frequencies the actuators of a study carry."""
    return all(
        one.shaping is not None or one.carries_hz is not None or one.inverse_ahead_ms is not None
        for one in (own.actuator for own in sites(protocol, rig).values())
    )


def sites(protocol: Protocol, rig: Rig) -> dict[str | None, Rig]:
    """Return the rig at each site of a study, None for one without sites. Raises `RigError` for a site it lacks."""
    return {site: rig.at(site) for site in protocol.limits_m_s2}


def companions(protocol: Protocol) -> Iterator[Finding]:
    """Yield what is wrong with, or odd about, the recordings that a protocol plays, whatever the rig."""
    for i, one in enumerate(protocol.table(Presented).stimuli):
        limit_m_s2, limit = _limit(protocol, one.site)
        for j, part in enumerate(one.parts):
            if part.recorded is None:
                continue
            place = f"presented.stimuli[{i}].parts[{j}].recorded"
            try:
                heard = recording(protocol, part.recorded)
            except RecordingError as error:
                yield replace(error.finding, field=place)
                continue
            played = waves.ramped(heard.m_s2 - heard.m_s2.mean(), rate_hz=heard.rate_hz, ramp_s=part.ramp_s)
            peak_m_s2 = float(np.abs(played).max())
            if peak_m_s2 > limit_m_s2:
                most = part.recorded.full_scale_m_s2 * limit_m_s2 / peak_m_s2
                yield Finding(
                    f"got a peak of {peak_m_s2:.3g} m/s^2 in {heard.file}",
                    field=f"{place}.full_scale_m_s2",
                    allowed=f"at most {limit}",
                    remedy=f"lower full_scale_m_s2 to {most:.3g} (which weakens the stimulus), or play another part "
                    "of the file",
                )
            yield from _doubts(heard, place)


def _doubts(heard: Recording, place: str) -> Iterator[Finding]:
    """Yield what is odd about a recording, which nothing refuses."""
    from palpate.experiment.recordings.grid import clipping

    if heard.left_s > LEFT_S:
        what = f"{heard.file} continues for {heard.left_s:g} s after the part that is played"
        remedy = "check begins_s and lasts_s, or trim the file to the part that is played"
        yield Finding(what, field=f"{place}.lasts_s", remedy=remedy, verdict="warns")
    if heard.rate_hz < LEAST_HZ:
        what = f"got {heard.rate_hz} samples a second in {heard.file}, which has nothing above {heard.rate_hz / 2:g} Hz"
        allowed = f"usually {LEAST_HZ} or more, because people can feel vibrations up to about {LEAST_HZ // 2} Hz"
        remedy = "check the rate in the file's header, or record at a higher one"
        yield Finding(what, field=f"{place}.file", allowed=allowed, remedy=remedy, verdict="warns")
    if (clipped := clipping(heard.m_s2)) is not None:
        what = (
            f"{heard.file} looks clipped: {clipped.samples} samples in {clipped.runs} runs are at the end of its range"
        )
        remedy = "record it again with less gain"
        yield Finding(what, field=f"{place}.file", remedy=remedy, verdict="warns")


def judge(*, protocol: Protocol, rig: Rig, rig_file: Path, today: date, **_: object) -> str:
    """Return what a rig leaves out at most, as far as somebody measured. Raises `RigError` for one that is refused."""
    for site, own in sites(protocol, rig).items():
        refuse_unmeasured(rig_file, own, today)
        if site is not None and own.audio is not None and not rig.rig.simulated:
            check_age(own.audio.latency, today, site)
    every = on_rig(protocol=protocol, rig=rig, rig_folder=rig_file.parent)
    if (refused := next(refusals(protocol, rig, every), None)) is not None:
        raise RigError.at(refused)
    most = max(every, key=lambda one: one.left_out)
    told = f"at most {most.left_out:.2%} (rms) of {most.material} is left out" if most.left_out >= SHOWN else ""
    return (
        told
        if is_known(protocol, rig)
        else (f"{UNKNOWN}; if it carries all frequencies, {told or 'nothing is left out'}")
    )


def examine(*, protocol: Protocol, rig: Rig, rig_file: Path, **_: object) -> tuple[str, PalpateError | None]:
    """Return what the board reads of a rig, and why no participant is run on it, if so; raises as `on_rig`."""
    every = on_rig(protocol=protocol, rig=rig, rig_folder=rig_file.parent)
    refused = next(refusals(protocol, rig, every), None)
    unknown = "" if is_known(protocol, rig) else f": {UNKNOWN}; if it carries all frequencies, it"
    told = f"Rig '{rig.rig.name}'{unknown} produces these stimuli: {'; '.join(one.words for one in every)}."
    return told, None if refused is None else RigError.at(refused)
