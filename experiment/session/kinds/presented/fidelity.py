"""What a rig makes of the stimuli that a protocol declares: peak, seconds and what it leaves out; and which it may not
play."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from palpate.experiment.apparatus.panel.conditioning import open_conditioner, open_drive
from palpate.experiment.apparatus.panel.validity import refuse_unmeasured
from palpate.experiment.apparatus.rig import ActuatorRig, Rig
from palpate.experiment.errors import Finding, PalpateError, Remedy, RigError
from palpate.experiment.protocol.kinds.presented import Presented
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.session.kinds.presented.stimuli import peak_m_s2, rendered

UNKNOWN = "nobody measured which frequencies its actuator carries"

SHOWN = 5e-6
"""A share is told from here on: 0.0005 %."""


@dataclass(frozen=True)
class Made:
    """What a rig makes of the stimulus of a material, as a session would hand it over.

    `asked_m_s2` is the peak that is declared, `reached_m_s2` the panel's at most, by its measured response. Shares are
    of the rms: `left_out` of what it does not carry, `off` of all that differs. `limited`: a limit changes it.
    """

    material: str
    lasts_s: float
    asked_m_s2: float
    reached_m_s2: float
    left_out: float
    off: float
    limited: bool

    @property
    def words(self) -> str:
        """The same in words."""
        out = f"{self.left_out:.2%} (rms) left out" if self.left_out >= SHOWN else "nothing left out"
        peak = f"{self.reached_m_s2:.3g} m/s^2 at its peak, of {self.asked_m_s2:.3g} asked for"
        return f"{self.material}: {self.lasts_s:g} s, {peak}, {out}{', taken down by a limit' if self.limited else ''}"


def on_rig(*, protocol: Protocol, rig: Rig, rig_folder: Path) -> tuple[Made, ...]:
    """Return what a rig makes of every stimulus of a study. Raises as `rendered` and `conditioning.open_drive`."""
    limit_m_s2, actuator = protocol.exposure.vibration_peak_m_s2, rig.actuator
    drive = open_drive(rig_folder, actuator, limit_m_s2=limit_m_s2)
    condition = open_conditioner(rig, limit_m_s2=limit_m_s2, drive=drive)
    found = []
    for material, stimulus in rendered(protocol, actuator.rate_hz).items():
        played = condition(stimulus)
        kept = played.on_record()
        found.append(
            Made(
                material,
                kept.lasts_s,
                peak_m_s2(stimulus),
                kept.reached_peak_m_s2,
                kept.computed.left_out or 0.0,
                kept.computed.relative_error,
                limited=bool(played.limited) or played.scale < 1 or played.panel_scale < 1,
            )
        )
    return tuple(found)


def refusals(protocol: Protocol, rig: Rig, every: tuple[Made, ...]) -> Iterator[Finding]:
    """Yield why no participant is run on a rig that makes this of the stimuli."""
    where, actuator = f"rig '{rig.rig.name}'", rig.actuator
    for one in every:
        if one.limited:
            limit = f"exposure.vibration_peak_m_s2 ({protocol.exposure.vibration_peak_m_s2:g})"
            yield Finding(
                f"got a stimulus that a limit changes ({one.words})",
                where,
                allowed=f"one within {limit} and the rig's full scale",
                remedy="lower its amplitude in the protocol",
            )
    most = protocol.table(Presented).left_out_max
    if most is None:
        return
    if not is_known(actuator):
        remedy: Remedy | str = "measure the panel, and write actuator.low_hz and high_hz into the rig file"
        yield Finding(UNKNOWN, where, allowed="a band that is known, by presented.left_out_max", remedy=remedy)
    for one in every:
        if one.left_out > most:
            allowed = f"{100 * most:.6g} % left out, by presented.left_out_max"
            yield Finding(f"got {one.words}", where, allowed=allowed, remedy="present what this rig carries")


def is_known(actuator: ActuatorRig) -> bool:
    """Return whether somebody measured which frequencies an actuator carries."""
    return actuator.shaping is not None or actuator.carries_hz is not None or actuator.inverse_ahead_ms is not None


def judge(*, protocol: Protocol, rig: Rig, rig_file: Path, today: date, **_: object) -> str:
    """Return what a rig leaves out at most, as far as somebody measured. Raises `RigError` for one that is refused."""
    refuse_unmeasured(rig_file, rig, today)
    every = on_rig(protocol=protocol, rig=rig, rig_folder=rig_file.parent)
    if (refused := next(refusals(protocol, rig, every), None)) is not None:
        raise RigError.at(refused)
    most = max(every, key=lambda one: one.left_out)
    told = f"at most {most.left_out:.2%} (rms) of {most.material} is left out" if most.left_out >= SHOWN else ""
    return told if is_known(rig.actuator) else f"{UNKNOWN}; if it carries all, {told or 'nothing is left out'}"


def examine(*, protocol: Protocol, rig: Rig, rig_file: Path, **_: object) -> tuple[str, PalpateError | None]:
    """Return what the board reads of a rig, and why no participant is run on it, if so; raises as `on_rig`."""
    every = on_rig(protocol=protocol, rig=rig, rig_folder=rig_file.parent)
    refused = next(refusals(protocol, rig, every), None)
    unknown = "" if is_known(rig.actuator) else f": {UNKNOWN}; if it carries all, it"
    told = f"Rig '{rig.rig.name}'{unknown} makes of the stimuli: {'; '.join(one.words for one in every)}."
    return told, None if refused is None else RigError.at(refused)
