"""What a board's page says of presented stimuli."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from palpate.experiment.protocol.blocks import Block, Item, Said, count, facts, named, number
from palpate.experiment.protocol.kinds.presented import SAMPLE_KEYS, Part, Presented, PresentedStimulus
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.protocol.page.words import KindWords

_SET_OFF = {
    "experimenter": "The experimenter starts each presentation with a key.",
    "participant": "Participants start each presentation themselves with a key.",
    "clock": "Each presentation starts automatically.",
}

_WAVES: Mapping[str, Callable[[Any], str]] = {
    "sinusoid": lambda it: (
        f"a sinusoid of {number(it.frequency_hz)} Hz with a peak of {number(it.amplitude_m_s2)} m/s^2"
    ),
    "decaying": lambda it: (
        f"a sinusoid of {number(it.frequency_hz)} Hz and {number(it.amplitude_m_s2)} m/s^2 that decays as exp(-B t), "
        f"with B = {number(it.decay_per_s)} /s"
    ),
    "noise": lambda it: (
        f"noise from {number(it.low_hz)} to {number(it.high_hz)} Hz, {number(it.rms_m_s2)} m/s^2 rms, generated with "
        f"the seed {it.seed}"
    ),
    "sweep": lambda it: (
        f"a sinusoid that sweeps from {number(it.from_hz)} to {number(it.to_hz)} Hz at a constant rate in {it.by}, "
        f"with a peak of {number(it.amplitude_m_s2)} m/s^2"
    ),
    "pulses": lambda it: (
        f"a pulse every {number(it.every_s)} s, each a single cycle at {number(it.cycle_hz)} Hz with a peak of "
        f"{number(it.amplitude_m_s2)} m/s^2"
    ),
    "recorded": lambda it: (
        f"the recording {named(it.file)}, starting at {number(it.begins_s)} s, with a full scale of "
        f"{number(it.full_scale_m_s2)} m/s^2 and the SHA-256 {it.sha256}"
    ),
    "silence": lambda _: "nothing",
}


ALIKE_S = 0.001
"""Stimuli that differ by less are of one length; ours."""


def _stimuli(protocol: Protocol) -> Iterator[Block]:
    table = protocol.table(Presented)
    yield Said(
        f"{_SET_OFF[table.set_off]} No stimulus is presented within {number(table.gap_s)} s of an answer or during a "
        "question. Each stimulus is described here as the acceleration of the touched surface and is the same every "
        "time:"
    )
    for one in table.stimuli:
        at = "" if one.site is None else f" at {named(one.site)}"
        yield Item(f"{named(one.material)}{at}: {_declared(one)}.")
    if table.sites:
        yield Said(
            f"An actuator at each of {count(len(table.sites), 'site')} of the body plays the stimuli listed for it, "
            "while the others are silent. palpate limits the peak acceleration at each site:"
        )
        yield facts(*((one.name, f"{one.place}; {number(one.peak_m_s2)} m/s^2") for one in table.sites))
    yield Said(
        "The familiarization plays each stimulus once. Until the longest familiarization time has passed, the "
        "experimenter can replay any stimulus with its key. If levels change, each stimulus is played at its "
        "strongest and its weakest level."
    )
    if table.pause_s is not None:
        yield Said(
            f"If a trial presents several stimuli, there are {number(table.pause_s)} s between the end of each and "
            "the start of the next."
        )
    yield Said(
        "The protocol does not limit how much of a stimulus a rig may leave out because it cannot reproduce its "
        "frequencies. Each trial's record shows the share left out."
        if table.left_out_max is None
        else f"No session runs on a rig that cannot reproduce more than {number(100 * table.left_out_max)} % (rms) of "
        "any stimulus, or on a rig whose frequency response is unknown."
    )
    yield Said(
        "No session runs on a rig whose vibration limit changes any of these stimuli. Participants are not told "
        "whether an answer was right."
    )


def _declared(stimulus: PresentedStimulus) -> str:
    parts = "; then ".join(map(_part, stimulus.parts))
    return parts if len(stimulus.parts) == 1 else f"{parts}. Total: {number(round(stimulus.lasts_s, 6))} s"


def _part(part: Part) -> str:
    name, wave = part.wave
    ramp = f", with ramps of {number(part.ramp_s)} s at both ends" if part.ramp_s else ""
    return f"{_WAVES[name](wave)}, for {number(part.lasts_s)} s{ramp}"


def _felt(protocol: Protocol, task: Task) -> str:
    vibrates_s = {
        one.material: sum(part.lasts_s for part in one.parts if part.silence is None)
        for one in protocol.table(Presented).stimuli
    }
    each_s = [sum(vibrates_s.get(material, 0.0) for material in one) for one in protocol.presentations(task)]
    trained_s = (protocol.felt_trials(task) - protocol.trials(task)) * max(each_s)
    total_s = number(round(task.repetitions * sum(each_s) + trained_s, 1))
    before_s = number(task.familiarisation.max_s)
    return (
        f"In task {task.id} the trials vibrate for at most {total_s} s in total, silence not counted, if none is "
        f"repeated. The task's familiarization plays stimuli for at most {before_s} s."
    )


def _odd(protocol: Protocol) -> Iterator[tuple[str, str, str]]:
    for i, task in enumerate(protocol.tasks):
        samples = len(protocol.materials_of(task)) * (1 if task.levels is None else 2)
        if samples > len(SAMPLE_KEYS):
            allowed = (
                f"usually {len(SAMPLE_KEYS)} or fewer: the familiarization has keys for only that many stimuli and "
                "plays no others"
            )
            yield f"tasks[{i}].materials", f"{samples} stimuli in the familiarization", allowed
    stimuli, peaks_m_s2 = protocol.table(Presented).stimuli, protocol.table(Presented).peaks_m_s2
    silent = {one.material for one in stimuli if all(part.silence is not None for part in one.parts)}
    longest_s = max((one.lasts_s for one in stimuli if one.material not in silent), default=0.0)
    played: dict[object, str] = {}
    for i, one in enumerate(stimuli):
        field = f"presented.stimuli[{i}]"
        if one.material not in silent and peaks_m_s2.get(one.material) == 0:
            allowed = "usually an amplitude above 0: this stimulus cannot be felt (for silence, use the wave 'silence')"
            yield f"{field}.parts", f"a peak of 0 m/s^2 for {one.material}", allowed
        if one.material in silent and longest_s and abs(one.lasts_s - longest_s) > ALIKE_S:
            allowed = f"usually {longest_s:g} s, the duration of the others: its duration alone gives it away"
            yield f"{field}.parts", f"{one.lasts_s:g} s of nothing", allowed
        if one.parts[0].recorded is not None:
            first = played.setdefault(one.model_copy(update={"material": "", "parts": _unnamed(one)}), one.material)
            if first != one.material:
                allowed = f"usually a different recording from the one for {first}: the two feel the same"
                yield f"{field}.parts", f"the same recording for {one.material}", allowed


def _unnamed(stimulus: PresentedStimulus) -> tuple[Part, ...]:
    """Return the parts of a stimulus, whatever the files are called that it plays."""
    return tuple(
        part
        if part.recorded is None
        else part.model_copy(update={"recorded": part.recorded.model_copy(update={"file": ""})})
        for part in stimulus.parts
    )


WORDS = KindWords(
    odd=_odd,
    touched=lambda _: "touched surface",
    familiar=lambda _: "the stimuli are played, as section 7 states",
    sources={
        "virtual": "virtual: vibrations that the protocol declares",
        "real": "real: real objects (no trial of this kind presents them)",
    },
    recorded=lambda _: "when each stimulus began, ",
    stimuli=_stimuli,
    felt=_felt,
)
