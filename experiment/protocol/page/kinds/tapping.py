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
            "In each trial, two real samples lie in front of the participant, who can try each as often as they wish "
            "and switch between them freely. No device moves or vibrates. Participants are not told whether an answer "
            "was right."
        )
    if (virtual := rendered(protocol)) is not None:
        yield from _rendered(protocol, virtual)


def _rendered(protocol: Protocol, virtual: Tapping) -> Iterator[Block]:
    mass = "is fixed in place" if virtual.mass_kg is None else f"has a mass of {number(virtual.mass_kg)} kg"
    yield Said(
        "In a task with virtual surfaces, the hand moves a device, which pushes back when the hand reaches a block. "
        f"All surfaces share one block, which consists of a spring of {number(virtual.stiffness_n_m)} N/m and a "
        f"damper of {number(virtual.damping_n_s_m)} N s/m and {mass}. The force is computed {virtual.rate_hz} times a "
        "second. Force and vibration drop to zero if the device, the tracker or the program fails."
    )
    if virtual.crossovers_hz:
        yield Said(
            "Each surface has a crossover frequency: below it the block's force is felt, above it the vibration "
            "(first-order filters). The block then pushes only along its normal. The force filter changes with the "
            "surface; if the hand is inside the block at that moment, it feels no force until it has left the block."
        )
    yield Said(_force(protocol.exposure.force_peak_n or 0.0, virtual))
    yield Said(
        "At the touch, the finger feels the ringing of a tap: a sinusoid that decays as exp(-B t), with B = "
        f"{number(virtual.decay_per_s)} /s, and is stronger for faster taps. Its frequency, and its amplitude for a "
        f"tap at 200 mm/s{', before the filter' if virtual.crossovers_hz else ''}:"
    )
    for one in virtual.surfaces:
        ring = round(one.amplitude * virtual.full_m_s2, 6)
        when = "" if one.delay_ms is None else f", {_when(one.delay_ms)}"
        hands_over = _hands_over(one.crossover_hz, one.attack_hz, virtual.decay_per_s)
        yield Item(f"{named(one.material)}: {number(one.attack_hz)} Hz, {number(ring)} m/s^2{when}{hands_over}.")
    if ahead_ms := virtual.ahead_ms:
        yield Said(
            f"A vibration that starts up to {number(ahead_ms)} ms before the touch is timed by predicting the touch "
            "from the hand's movement; the timing error is recorded. If the hand falls too fast or too unevenly for "
            "a prediction, the vibration starts at the touch. If the hand turns back, the participant may have felt "
            "the vibration without a touch. Both cases are recorded."
        )
    yield Said(
        "Participants can switch between the two surfaces of a pair as often as they wish: they say so, and the "
        f"experimenter presses [{virtual.switch_key}]. No answer is accepted until both have been tapped. A lamp "
        f"lights when the hand is faster than {number(virtual.fastest_mm_s)} mm/s. Participants are not told whether "
        "an answer was right."
    )


def _hands_over(crossover_hz: float | None, attack_hz: float, decay_per_s: float) -> str:
    """Return the crossover, and the rms that its filter leaves of exp(-B t) sin(W t), by Parseval."""
    if crossover_hz is None:
        return ""
    turns = 2 * pi * attack_hz
    left = hypot(decay_per_s, turns) / hypot(decay_per_s + 2 * pi * crossover_hz, turns)
    return f", crossover at {number(crossover_hz)} Hz, which passes {100 * left:.3g} % of the vibration (rms)"


def _when(delay_ms: float) -> str:
    if not delay_ms:
        return "at the touch"
    return f"{number(abs(delay_ms))} ms {'after' if delay_ms > 0 else 'before'} the touch"


def _force(limit_n: float, virtual: Tapping) -> str:
    """Return what the block asks of a device, beside what it may get."""
    k, c, fastest = virtual.stiffness_n_m, virtual.damping_n_s_m, virtual.fastest_mm_s
    asked_n = c * fastest * 1e-3
    said = f"For a touch at {number(fastest)} mm/s, the damper alone would need {asked_n:.4g} N"
    if asked_n > limit_n:
        said += f", of which the participant feels at most {number(limit_n)} N"
    if virtual.crossovers_hz:
        least_hz = least_crossover_hz(k, c)
        return (
            f"{said}; the filter passes only part of this force. The block cannot feed energy into the hand, because "
            f"no crossover is below K / (2 pi C), {least_hz:.4g} Hz. This still holds when a servo samples the "
            "motion, provided the device has enough damping (Colgate and Schenkel 1997); no session runs on a rig "
            "with less."
        )
    return said + (
        ". A fixed block cannot feed energy into the hand (Colgate and Schenkel 1997) on a device whose own damping "
        f"is at least {k / virtual.rate_hz / 2 + c:.4g} N s/m (K T / 2 + C), if speed is computed as the difference "
        "between two samples. Less damping is enough if the servo also uses the force that it sent. No session runs "
        "on a rig with less damping than it needs."
    )


def _force_error(protocol: Protocol) -> str:
    """Return what the board reads beside the limit of the force."""
    if (virtual := rendered(protocol)) is None:
        return ""
    limit = "The protocol does not limit how far a smaller force may be from the block's"
    if virtual.crossovers_hz:
        limit = "How far a smaller force is from the block's is not known"
    elif virtual.force_error_max is not None:
        limit = (
            f"No session runs on a rig whose force error exceeds {number(100 * virtual.force_error_max)} % (rms, "
            "relative to the block's force within the limit) when a simulated hand rests inside the block or taps on it"
        )
    return f" sent to the device. What the device delivers is not measured, so its own error adds to this. {limit}"


def _felt(protocol: Protocol, task: Task) -> str:
    if (virtual := rendered(protocol)) is None:
        return ""
    latest_ms = max((one.delay_ms or 0.0 for one in virtual.surfaces), default=0.0)
    faded_ms = 1e3 * log(1e3) / virtual.decay_per_s + max(latest_ms, 0.0)
    told = f"In task {task.id} the finger is vibrated at every tap. The number of taps is limited only by the time."
    return f"{told} Each vibration decays to a thousandth of its amplitude within {faded_ms:.0f} ms."


def _recorded(protocol: Protocol) -> str:
    if rendered(protocol) is None:
        return ""
    return "the time and speed of each tap on a virtual surface, each switch between surfaces, "


WORDS = KindWords(
    force=_force_error,
    touched=lambda _: "device",
    familiar=lambda task: "nothing vibrates" + (", and the block pushes back" if task.stimulus == "virtual" else ""),
    sources={
        "virtual": "virtual: surfaces that the rig renders",
        "real": "real: the experimenter lays out both samples before each trial",
    },
    recorded=_recorded,
    stimuli=_stimuli,
    felt=_felt,
)
