"""One step of the foot, from arming to just after contact, and the stimulus it sets off."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from experiment.apparatus.gate import Contact, Gate, GateDetector
from experiment.apparatus.ports import Actuator, LinkCounts, Tracker
from experiment.clock import Clock
from experiment.records import Stimulus
from experiment.scene import Render

if TYPE_CHECKING:
    from experiment.synthesis.crinkle import Synthesised

TAIL_US = 100_000
"""How long the foot is recorded after contact, so that the landing is on file."""


@dataclass(frozen=True)
class WatchedStep:
    """What a step was.

    Attributes:
        first_us: device time of the first sample after arming.
        first_t_ns: session time at which it was read.
        gate: the passage through the gate that led to contact.
        contact: the contact.
        raw: every byte of the tracker from arming to the end of the tail.
        link: frames counted from arming to contact.
        stimulus: what was handed to the actuator; None in a task without synthesis.
    """

    first_us: int
    first_t_ns: int
    gate: Gate
    contact: Contact
    raw: bytes
    link: LinkCounts
    stimulus: Stimulus | None


def watch(
    *,
    tracker: Tracker,
    detector: GateDetector,
    clock: Clock,
    material: str,
    render: Render | None,
    actuator: Actuator | None,
) -> WatchedStep:
    """Wait for a step, and play its stimulus when the foot lands.

    The stimulus is synthesised as soon as the foot has left the gate, and handed over at contact.

    Raises:
        TrackerStopped: the tracker fell silent.
        ActuatorError: the stimulus could not be handed over.
    """
    before = tracker.counts
    state = detector.init()
    samples = tracker.read()
    first = int(samples.device_us[0]), clock.now_ns()
    raw, received = bytearray(), 0
    gate: Gate | None = None
    contact: Contact | None = None
    rendered: Synthesised | None = None
    while True:
        state, events = detector.step(state, samples)
        for event in events:
            if isinstance(event, Gate):
                gate = event
                rendered = render(material, gate.speed_mm_s, actuator.rate_hz) if render and actuator else None
            elif gate is not None:
                contact = event
                break
        if gate is not None and contact is not None:
            break
        raw += samples.raw
        received += samples.device_us.size
        samples = tracker.read()
    received += int(np.searchsorted(samples.device_us, contact.us, side="right"))
    link = replace(tracker.counts.since(before), received=received)
    contact_ns = first[1] + round((contact.us - first[0]) * 1e3)
    stimulus = _play(rendered, actuator, contact_ns) if rendered is not None and actuator is not None else None
    while samples.device_us[-1] < contact.us + TAIL_US:
        raw += samples.raw
        samples = tracker.read()
    # What came in the same read after the tail is left out, so that a trace does not depend on how reads were cut.
    raw += samples.raw[: int(samples.ends[np.searchsorted(samples.device_us, contact.us + TAIL_US)])]
    return WatchedStep(*first, gate, contact, bytes(raw), link, stimulus)


def _play(rendered: Synthesised, actuator: Actuator, contact_ns: int) -> Stimulus:
    played = actuator.prepare(rendered.waveform_m_s2)
    actuator.landed(contact_ns)
    return Stimulus(
        sha256=hashlib.sha256(np.asarray(rendered.waveform_m_s2, "<f8").tobytes()).hexdigest(),
        samples=played.samples,
        rate_hz=actuator.rate_hz,
        floored_bins=rendered.floored_bins,
        extrapolated=rendered.extrapolated,
        limited=played.limited,
        peak_m_s2=played.peak_m_s2,
        driven=played.driven,
    )
