"""What a board's page says of presented stimuli."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from palpate.experiment.protocol.blocks import Block, Item, Said, named, number
from palpate.experiment.protocol.kinds.presented import SAMPLE_KEYS, Part, Presented, PresentedStimulus
from palpate.experiment.protocol.models import Protocol, Task
from palpate.experiment.protocol.page.words import KindWords

_SET_OFF = {
    "experimenter": "The experimenter sets off what a trial presents, by a key.",
    "participant": "The participants set off what a trial presents themselves, by a key.",
    "clock": "What a trial presents begins by itself.",
}

_WAVES: Mapping[str, Callable[[Any], str]] = {
    "sinusoid": lambda it: f"a sinusoid of {number(it.frequency_hz)} Hz, {number(it.amplitude_m_s2)} m/s^2 at its peak",
    "decaying": lambda it: (
        f"a sinusoid of {number(it.frequency_hz)} Hz and {number(it.amplitude_m_s2)} m/s^2 that fades by exp(-t B), "
        f"with B = {number(it.decay_per_s)} /s"
    ),
    "noise": lambda it: (
        f"noise from {number(it.low_hz)} to {number(it.high_hz)} Hz, {number(it.rms_m_s2)} m/s^2 rms, drawn from the "
        f"seed {it.seed}"
    ),
    "sweep": lambda it: (
        f"a sinusoid whose frequency goes from {number(it.from_hz)} to {number(it.to_hz)} Hz by even {it.by}, "
        f"{number(it.amplitude_m_s2)} m/s^2 at its peak"
    ),
    "pulses": lambda it: (
        f"a pulse every {number(it.every_s)} s, each one cycle of {number(it.cycle_hz)} Hz with "
        f"{number(it.amplitude_m_s2)} m/s^2 at its peak"
    ),
    "recorded": lambda it: (
        f"the recording {named(it.file)} from {number(it.begins_s)} s on, {number(it.full_scale_m_s2)} m/s^2 at full "
        f"scale, with the SHA-256 {it.sha256}"
    ),
    "silence": lambda _: "nothing",
}


ALIKE_S = 0.001
"""Stimuli that differ by less are of one length; ours."""


def _stimuli(protocol: Protocol) -> Iterator[Block]:
    table = protocol.table(Presented)
    yield Said(
        f"{_SET_OFF[table.set_off]} Nothing is felt within {number(table.gap_s)} s of an answer, nor while a question "
        "is open. Each stimulus is as stated here, in the acceleration of what is touched, and is the same each time:"
    )
    for one in table.stimuli:
        yield Item(f"{named(one.material)}: {_declared(one)}.")
    yield Said(
        "The familiarisation plays each stimulus once, and again as often as the experimenter presses its key within "
        "its longest time; where levels change, each as strong and as weak as they make it."
    )
    if table.pause_s is not None:
        yield Said(
            f"Where a trial presents several, {number(table.pause_s)} s lie between the end of one and the next."
        )
    yield Said(
        "The protocol sets no limit to what a rig may leave out of a stimulus because it cannot carry its "
        "frequencies. Each trial's record says what share was left out."
        if table.left_out_max is None
        else f"No participant is run on a rig that leaves out more than {number(100 * table.left_out_max)} % (rms) of "
        "any stimulus because it cannot carry its frequencies, or of which nobody knows what it carries."
    )
    yield Said(
        "No participant is run on a rig whose limit of vibration changes any of these stimuli. Nobody tells the "
        "participant whether an answer was right."
    )


def _declared(stimulus: PresentedStimulus) -> str:
    parts = "; then ".join(map(_part, stimulus.parts))
    return parts if len(stimulus.parts) == 1 else f"{parts}. In all {number(round(stimulus.lasts_s, 6))} s"


def _part(part: Part) -> str:
    name, wave = part.wave
    ramp = f", with ramps of {number(part.ramp_s)} s at both ends" if part.ramp_s else ""
    return f"{_WAVES[name](wave)}, for {number(part.lasts_s)} s{ramp}"


def _felt(protocol: Protocol, task: Task) -> str:
    lasts_s = {one.material: one.lasts_s for one in protocol.table(Presented).stimuli}
    each_s = [sum(lasts_s.get(material, 0.0) for material in one) for one in protocol.presentations(task)]
    trained_s = (protocol.felt_trials(task) - protocol.trials(task)) * max(each_s)
    total_s = number(round(task.repetitions * sum(each_s) + trained_s, 1))
    before_s = number(task.familiarisation.max_s)
    return (
        f"In task {task.id} stimuli last {total_s} s in all at most, if no trial is repeated, and its familiarisation "
        f"plays some for {before_s} s at most."
    )


def _odd(protocol: Protocol) -> Iterator[tuple[str, str, str]]:
    for i, task in enumerate(protocol.tasks):
        samples = len(protocol.materials_of(task)) * (1 if task.levels is None else 2)
        if samples > len(SAMPLE_KEYS):
            allowed = (
                f"as a rule {len(SAMPLE_KEYS)} or fewer: the familiarisation has keys for so many, and plays no others"
            )
            yield f"tasks[{i}].materials", f"{samples} stimuli to become familiar with", allowed
    stimuli, peaks_m_s2 = protocol.table(Presented).stimuli, protocol.table(Presented).peaks_m_s2
    silent = {one.material for one in stimuli if all(part.silence is not None for part in one.parts)}
    longest_s = max((one.lasts_s for one in stimuli if one.material not in silent), default=0.0)
    played: dict[object, str] = {}
    for i, one in enumerate(stimuli):
        field = f"presented.stimuli[{i}]"
        if one.material not in silent and peaks_m_s2.get(one.material) == 0:
            allowed = "as a rule an amplitude above 0: nothing of it is felt, and silence is a wave of its own"
            yield f"{field}.parts", f"a peak of 0 m/s^2 of {one.material}", allowed
        if one.material in silent and longest_s and abs(one.lasts_s - longest_s) > ALIKE_S:
            allowed = f"as a rule {longest_s:g} s, as long as the others: its length alone tells it from them"
            yield f"{field}.parts", f"{one.lasts_s:g} s of nothing", allowed
        if one.parts[0].recorded is not None:
            first = played.setdefault(one.model_copy(update={"material": "", "parts": _unnamed(one)}), one.material)
            if first != one.material:
                allowed = f"as a rule another recording than that of {first}: nobody can tell the two apart"
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
    sources={
        "virtual": "virtual: vibrations that the protocol declares",
        "real": "real: objects, which no trial of this kind presents",
    },
    recorded=lambda _: "when each stimulus began, ",
    stimuli=_stimuli,
    felt=_felt,
)
