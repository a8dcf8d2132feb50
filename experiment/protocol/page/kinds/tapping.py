"""What a board's page says of taps on samples or on virtual surfaces."""

from collections.abc import Iterator
from math import hypot, log, pi

from palpate.experiment.protocol.blocks import Block, Item, Said, named, number
from palpate.experiment.protocol.kinds.tapping import Tapping, least_crossover_hz, rendered
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.protocol.page.words import KindWords


def _stimuli(protocol: Protocol) -> Iterator[Block]:
    if any(task.stimulus == "real" for task in protocol.tasks):
        yield Said(
            "Two real samples lie before the participant in each trial, who tries them as often as they wish, and "
            "changes from one to the other as often as they wish. No device moves or vibrates, and nobody tells the "
            "participant whether an answer was right."
        )
    if (virtual := rendered(protocol)) is not None:
        yield from _rendered(protocol, virtual)


def _rendered(protocol: Protocol, virtual: Tapping) -> Iterator[Block]:
    mass = "is held" if virtual.mass_kg is None else f"has a mass of {number(virtual.mass_kg)} kg"
    yield Said(
        "In a task with virtual surfaces the hand moves a device, which pushes it back where a block begins. All "
        f"surfaces have one block: a spring of {number(virtual.stiffness_n_m)} N/m and a damper of "
        f"{number(virtual.damping_n_s_m)} N s/m, and it {mass}. The force is computed {virtual.rate_hz} times a second "
        f"and is never above {number(protocol.exposure.force_peak_n or 0.0)} N. It falls to zero, as does the "
        "vibration, where the device, the tracker or the program fails."
    )
    if virtual.crossovers_hz:
        yield Said(
            "Each surface has a crossover: below it the block's force is felt, and above it the vibration (filters of "
            "first order). The block then pushes along its normal alone. With the surface the force's filter changes, "
            "and a hand that is inside then feels no force until it has been outside."
        )
    yield Said(_force(protocol.exposure.force_peak_n or 0.0, virtual))
    yield Said(
        "At the touch the finger is vibrated as a tap rings: a sinusoid that fades by exp(-t B), with B = "
        f"{number(virtual.decay_per_s)} /s, and grows with the speed of the tap. Its frequency, and its amplitude at "
        f"200 mm/s{', before the filter' if virtual.crossovers_hz else ''}:"
    )
    for one in virtual.surfaces:
        ring = round(one.amplitude * virtual.full_m_s2, 6)
        when = "" if one.delay_ms is None else f", {_when(one.delay_ms)}"
        hands_over = _hands_over(one.crossover_hz, one.attack_hz, virtual.decay_per_s)
        yield Item(f"{named(one.material)}: {number(one.attack_hz)} Hz, {number(ring)} m/s^2{when}{hands_over}.")
    if ahead_ms := virtual.ahead_ms:
        yield Said(
            f"A vibration of up to {number(ahead_ms)} ms before the touch is timed by a prediction from how the hand "
            "falls, whose error is on record. A hand that falls too fast or too unevenly to be predicted gets it at "
            "the touch, and one that turns back may have felt it: both are on record."
        )
    yield Said(
        "The participant changes from one surface of a pair to the other as often as they wish: they say so, and the "
        f"experimenter presses [{virtual.switch_key}]. No answer is taken before both were tapped. A lamp says when "
        f"the hand is faster than {number(virtual.fastest_mm_s)} mm/s. Nobody tells the participant whether an answer "
        "was right."
    )


def _hands_over(crossover_hz: float | None, attack_hz: float, decay_per_s: float) -> str:
    """Return the crossover, and the rms that its filter leaves of exp(-B t) sin(W t), by Parseval."""
    if crossover_hz is None:
        return ""
    turns = 2 * pi * attack_hz
    left = hypot(decay_per_s, turns) / hypot(decay_per_s + 2 * pi * crossover_hz, turns)
    return f", crossover at {number(crossover_hz)} Hz, which leaves {100 * left:.3g} % of it (rms)"


def _when(delay_ms: float) -> str:
    if not delay_ms:
        return "at the touch"
    return f"{number(abs(delay_ms))} ms {'after' if delay_ms > 0 else 'before'} the touch"


def _force(limit_n: float, virtual: Tapping) -> str:
    """Return what the block asks of a device, beside what it may get, and how far the force may be off."""
    k, c, fastest = virtual.stiffness_n_m, virtual.damping_n_s_m, virtual.fastest_mm_s
    asked_n = c * fastest * 1e-3
    said = f"At a touch of {number(fastest)} mm/s the damper asks {asked_n:.4g} N"
    if asked_n > limit_n:
        said += f", and the participant feels {number(limit_n)} N of it at most"
    if virtual.crossovers_hz:
        least_hz = least_crossover_hz(k, c)
        return (
            f"{said}; the filter lets less of it through. It gives no energy to the hand, for no crossover is below "
            f"K / (2 pi C), {least_hz:.4g} Hz; nor does a servo that samples it, on a device with enough damping of "
            "its own (Colgate and Schenkel 1997), and no participant is run on a rig that has less. How far the force "
            "is off is not known."
        )
    said += (
        ". A fixed block cannot feed energy into the hand (Colgate and Schenkel 1997) on a device whose own damping is "
        f"at least {k / virtual.rate_hz / 2 + c:.4g} N s/m (K T / 2 + C) if speed is the difference of two samples. "
        "Less is enough if the servo also uses the force that it sent. No session runs on a rig with less damping than "
        "it needs. "
    )
    if virtual.force_error_max is None:
        return f"{said}No limit is set on how far the force may be off."
    return (
        f"{said}No session runs on a rig whose force is off by more than {number(100 * virtual.force_error_max)} % "
        "(rms, of the block's force within the limit) when a simulated hand rests inside or taps."
    )


def _felt(protocol: Protocol, task: Task) -> str:
    if (virtual := rendered(protocol)) is None:
        return ""
    latest_ms = max((one.delay_ms or 0.0 for one in virtual.surfaces), default=0.0)
    faded_ms = 1e3 * log(1e3) / virtual.decay_per_s + max(latest_ms, 0.0)
    told = f"In task {task.id} the finger vibrates at every tap, and nothing limits taps but the time."
    return f"{told} Each time it has faded to a thousandth after {faded_ms:.0f} ms."


def _recorded(protocol: Protocol) -> str:
    if rendered(protocol) is None:
        return ""
    return "the time and the speed of each tap on a virtual surface, each change from one to the other, "


WORDS = KindWords(
    sources={
        "virtual": "virtual: surfaces that the rig renders",
        "real": "real: the experimenter lays out both samples before each trial",
    },
    recorded=_recorded,
    stimuli=_stimuli,
    felt=_felt,
)
