"""What a task needs and leaves out, and what each omission saves and costs, as measured on this machine."""

from __future__ import annotations

import json
import statistics
import subprocess
import time
import tracemalloc
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from palpate.experiment import storage
from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus.audio.mixer import Mixer
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.protocol.models import Protocol
from palpate.experiment.recordings import manifest
from palpate.experiment.session import scene as scenes
from palpate.experiment.session.kinds.footstep import preparation
from palpate.experiment.session.kinds.footstep.error_budget import ErrorBudget, error_budget, percent, wrapped
from palpate.experiment.session.kinds.footstep.preparation import FLOOR
from palpate.experiment.session.scene import Scene
from palpate.experiment.synthesis.crinkle import CrinkleSpectra
from palpate.experiment.synthesis.waveforms import Basis

if TYPE_CHECKING:
    from palpate.experiment.apparatus.audio.stream import StreamSettings
    from palpate.experiment.synthesis.crinkle import CrinkleSpectra
    from palpate.experiment.synthesis.waveforms import Basis

REPEATS = 5


@dataclass(frozen=True)
class Timing:
    """A time as the median of repeats, ms, and how far these spread from the lower to the upper quartile, ms."""

    ms: float
    spread_ms: float

    @property
    def measurable(self) -> bool:
        """Return whether the time is more than the spread of the repeats; a smaller one is no saving."""
        return abs(self.ms) > self.spread_ms


@cache
def import_cost(modules: tuple[str, ...]) -> tuple[Timing, float | None]:
    """Return the time, and the median of resident memory, kB, that importing `modules` adds to a session without them.

    Each run is a new interpreter with a session's imports. The memory is None if the system does not report it.
    """
    code = (
        "import importlib, json, sys, time\n"
        "import palpate.experiment.session.run\n"
        "def kb():\n"
        "    try:\n"
        "        with open('/proc/self/statm') as file:\n"
        "            import resource\n"
        "            return int(file.read().split()[1]) * resource.getpagesize() / 1e3\n"
        "    except (OSError, ImportError):\n"
        "        return None\n"
        "held, begun = kb(), time.perf_counter()\n"
        "for name in sys.argv[1:]:\n"
        "    importlib.import_module(name)\n"
        "passed = time.perf_counter() - begun\n"
        "print(json.dumps([passed * 1e3, None if held is None else kb() - held]))\n"
    )
    command = storage.python_command("-c", code, *modules)
    outputs = [subprocess.run(command, capture_output=True, check=True).stdout for _ in range(REPEATS)]  # noqa: S603
    runs = [json.loads(output) for output in outputs]
    resident_kb = None if runs[0][1] is None else statistics.median(run[1] for run in runs)
    return taken([run[0] for run in runs]), resident_kb


def measured(call: Callable[[], object]) -> tuple[Timing, float]:
    """Return the time that a call takes, and the memory that its result holds, kB."""
    times = taken([ms(call) for _ in range(REPEATS)])
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    result = call()
    held = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    del result
    return times, held / 1e3


def taken(ms: list[float]) -> Timing:
    """Return median and spread of repeats, ms."""
    lower, median, upper = np.quantile(ms, [0.25, 0.5, 0.75]).tolist()
    return Timing(median, upper - lower)


def ms(call: Callable[[], object]) -> float:
    """Return the time that one call takes, ms."""
    begun = time.perf_counter()
    call()
    return (time.perf_counter() - begun) * 1e3


Kind = Literal["parts", "imports", "materials", "bins", "channels", "steps"]

ALWAYS = ("tracker", "gate and contact", "limiter", "exposure account", "journal", "foot trace")
"""What no task leaves out: safety, accounting and the record."""

STIMULUS_MODULES = (
    "palpate.experiment.recordings.manifest",
    "palpate.experiment.apparatus.panel.conditioning",
    "palpate.experiment.synthesis.waveforms",
    "palpate.experiment.synthesis.shaping",
    "palpate.experiment.apparatus.panel.pcm",
)
"""What a task with virtual stimuli imports and a task with real objects does not."""

SPEEDS_MM_S = tuple(float(v) for v in range(40, 420, 20))
"""Foot speeds at which times are taken."""

TURNS = 51
"""Rounds over all speeds where single steps are timed, for what a step takes more or less may be below 1 us."""


@dataclass(frozen=True)
class Omission:
    """One thing that a task leaves out: its kind, what it is, what that saves, and the error that it costs.

    `saves` is negative if it takes longer. `saves` and `saves_kb` (1 kB is 1000 bytes) are None if not measured.
    """

    kind: Kind
    what: str
    saves: Timing | None
    saves_kb: float | None
    costs: str

    def as_dict(self) -> dict[str, object]:
        """Return the omission for JSON; `saves_ms` is null if no difference could be measured."""
        time = self.saves
        return {
            "kind": self.kind,
            "what": self.what,
            "saves_ms": time.ms if time is not None and time.measurable else None,
            "spread_ms": time.spread_ms if time is not None else None,
            "saves_kb": self.saves_kb,
            "cost": self.costs,
        }

    def saved(self) -> str:
        """Return in words what it saves."""
        time, parts = self.saves, []
        if time is not None and time.measurable:
            parts.append(f"{_time(time.ms)} (IQR across repeats: {_time(time.spread_ms)})")
        if self.saves_kb is not None:
            parts.append(f"{self.saves_kb:.0f} kB")
        saved = f"saves {' and '.join(parts)}" if parts else "savings not measured"
        if time is None or time.measurable:
            return saved
        seen = f"no measurable difference in time ({_time(time.ms)}; IQR across repeats: {_time(time.spread_ms)})"
        return f"{saved}; {seen}" if parts else seen


@dataclass(frozen=True)
class TaskPlan:
    """What one task needs and leaves out; `budget` is None where no stimulus is played."""

    task: str
    title: str
    needs: tuple[str, ...]
    left_out: tuple[Omission, ...]
    budget: ErrorBudget | None = None

    def as_dict(self) -> dict[str, object]:
        return {
            "task": self.task,
            "needs": list(self.needs),
            "never_left_out": list(ALWAYS),
            "left_out": [omission.as_dict() for omission in self.left_out],
            "error_budget": None if self.budget is None else self.budget.as_dict(),
        }

    def text(self) -> str:
        lines = [f"Task {self.task}: {self.title}"]
        if self.refused:
            lines += ["", *wrapped(f"REFUSED for participants: {self.refused}", 4)]
        lines += ["", "needs", *(f"  {need}" for need in self.needs), "", "leaves out"]
        for o in self.left_out:
            lines += [f"  {o.kind:9} {o.what}", f"            {o.saved()}; costs {o.costs}"]
        lines += ["", f"never left out: {', '.join(ALWAYS)}"]
        shown = [part for line in lines for part in (wrapped(line, 12) or [""])]
        return "\n".join(shown if self.budget is None else [*shown, "", *self.budget.lines()])

    @property
    def refused(self) -> str:
        """Why no participant is run; empty where they are."""
        return "" if self.budget is None else self.budget.refused


def _time(ms: float) -> str:
    return f"{ms:.1f} ms" if abs(ms) >= 1 else f"{ms * 1e3:.1f} us"


def plan(
    *, protocol: Protocol, rig: Rig, rig_folder: Path, task_id: str, recordings: Path, process: str = ""
) -> TaskPlan:
    """Plan a task, and measure what it leaves out; `process` describes the task's process, if one was started.

    Raises `RecordingError` for a missing or unusable recording, and `RigError` for the response table in `rig_folder`.
    """
    scene = scenes.plan(protocol=protocol, task_id=task_id)
    title = protocol.task(task_id).title
    heard = (*sound(scene, protocol, rig), f"ports     {ports(scene, rig)}")
    heard += (f"process   {process}",) if process else ()
    if scene.synthesis:
        budget = error_budget(task_id=task_id, protocol=protocol, rig=rig, rig_folder=rig_folder, recordings=recordings)
        needs, left_out = _virtual(scene, protocol, rig, recordings, budget)
        return TaskPlan(task_id, title, (*heard, *needs), left_out, budget)
    needs = (*heard, f"parts     {', '.join(ALWAYS)}", "steps     laying out the real object before each trial")
    return TaskPlan(task_id, title, needs, _real(scene, protocol, rig, rig_folder, recordings))


def _stream(scene: scenes.Scene, protocol: Protocol, rig: Rig) -> StreamSettings:
    limits_m_s2 = protocol.limits_m_s2 if scene.actuator else {}
    return opening.session_stream(rig, limits_m_s2=limits_m_s2, listens=scene.listens, masker=None)


def sound(scene: scenes.Scene, protocol: Protocol, rig: Rig) -> tuple[str, ...]:
    """Return what a task needs for its masker, and of the audio device."""
    masker = f"masker    {scene.masker or 'no'} noise"
    if rig.audio is None or not scene.sounds(rig):
        return (masker if scene.masker is None else f"{masker}, from other equipment: the rig has no audio device",)
    stream = _stream(scene, protocol, rig)
    counted = f"{_counted(len(stream.ceilings), 'output')} and {_counted(stream.inputs, 'input')}"
    held_kb = measured(partial(Mixer, stream.layout()))[1]
    return (
        masker if scene.masker is None else f"{masker} on the headphones",
        f"stream    {counted} at {stream.rate_hz} Hz, {held_kb:.0f} kB of sound held",
    )


def ports(scene: scenes.Scene, rig: Rig) -> str:
    """Return which ports a task opens, of those that its rig has."""
    opened = ["the tracker's"]
    if scene.actuator and rig.actuator.address is not None:
        opened.append("the actuator's")
    if rig.audio is not None and scene.sounds(rig):
        opened.append("the audio device's own, as the stream reports it")
    return " and ".join(opened)


def _counted(number: int, noun: str) -> str:
    """Return a number of things in words."""
    return f"{number or 'no'} {noun}{'' if number == 1 else 's'}"


def _channel(scene: scenes.Scene, protocol: Protocol, rig: Rig) -> tuple[str, float | None]:
    """Return what a task without stimuli leaves out of the audio device, and what that would hold, kB."""
    if rig.audio is None or rig.actuator.driver != "audio":
        return "the actuator's channel", None
    whole, part = (_stream(one, protocol, rig) for one in (scenes.virtual(protocol), scene))
    outputs, inputs = len(whole.ceilings) - len(part.ceilings), whole.inputs - part.inputs
    held_kb, kept_kb = (measured(partial(Mixer, one.layout()))[1] for one in (whole, part))
    told = f"{_counted(outputs, 'output')} and {_counted(inputs, 'input')} of the audio device, and stimulus positions"
    return told, held_kb - kept_kb


def _real(
    scene: scenes.Scene, protocol: Protocol, rig: Rig, rig_folder: Path, recordings: Path
) -> tuple[Omission, ...]:
    from palpate.experiment.apparatus.panel.conditioning import open_drive

    virtual = scenes.virtual(protocol)
    load = partial(preparation.load_spectra, scene=virtual, protocol=protocol, recordings=recordings)
    imported, imported_kb = import_cost(STIMULUS_MODULES)
    loaded, loaded_kb = measured(load)
    prepare = partial(preparation.prepare_stimuli, load(), protocol=protocol, output_rate_hz=rig.actuator.rate_hz)
    prepared, prepared_kb = measured(prepare)
    materials = prepare()
    limit_m_s2 = protocol.exposure.vibration_peak_m_s2
    drive = partial(open_drive, rig_folder, rig.actuator, limit_m_s2=limit_m_s2, materials=materials)
    driven, driven_kb = measured(drive) if rig.actuator.shaping is not None else (None, None)
    shaped = drive()

    def at_gate(speed_mm_s: float) -> object:
        """What has to be there before contact: a device that takes volts waits for no waveform in m/s^2."""
        stimulus = materials[virtual.materials[0]].at(speed_mm_s)
        return stimulus.waveform_m_s2 if shaped is None else shaped(stimulus)

    rendered = taken([_step_ms(at_gate) for _ in range(TURNS)])
    channel, channel_kb = _channel(scene, protocol, rig)
    nothing = "nothing: no stimulus is played, so all records are identical"
    return (
        Omission("parts", "synthesis: prepared waveforms of every material", prepared, prepared_kb, nothing),
        Omission(
            "parts",
            "frequency shaping: voltages of every material, prepared where they fit",
            driven,
            driven_kb,
            nothing,
        ),
        Omission("parts", "actuator and its port", None, None, nothing),
        Omission("imports", ", ".join(STIMULUS_MODULES), imported, imported_kb, nothing),
        Omission("materials", f"spectra of {', '.join(virtual.materials)}", loaded, loaded_kb, nothing),
        Omission("channels", channel, None, channel_kb, nothing),
        Omission("steps", "rendering a stimulus between gate and contact, each trial", rendered, None, nothing),
    )


def _virtual(
    scene: scenes.Scene, protocol: Protocol, rig: Rig, recordings: Path, budget: ErrorBudget
) -> tuple[tuple[str, ...], tuple[Omission, ...]]:
    rate_hz = rig.actuator.rate_hz
    held = preparation.load_spectra(scene=scene, protocol=protocol, recordings=recordings)
    needs = [f"parts     {', '.join(ALWAYS)}, synthesis, actuator", f"imports   {', '.join(STIMULUS_MODULES)}"]
    left_out = [Omission("steps", "laying out a real object before each trial", None, None, "nothing")]
    others = besides(scene=scene, protocol=protocol, recordings=recordings)
    if others.materials:
        load = partial(preparation.load_spectra, scene=others, protocol=protocol, recordings=recordings)
        nothing = "nothing: no trial of this task presents these materials"
        left_out.append(Omission("materials", f"spectra of {', '.join(others.materials)}", *measured(load), nothing))
    for material, basis in preparation.prepare_stimuli(held, protocol=protocol, output_rate_hz=rate_hz).items():
        off = percent(*budget.materials[material].range(lambda one: one.total))
        way = "basis waveforms" if rig.actuator.shaping is None else "voltages, prepared where they fit"
        needs.append(f"material  {material}: {way}{basis.band}, off by {off} % (rms), {basis.nbytes / 1e3:.0f} kB")
        of = budget.materials[material]
        if basis.spectra.band_hz is not None:
            left_out.append(_bins(held[material], basis, protocol, percent(*of.range(lambda one: one.scene))))
        dropped = basis.spectra.dropped(basis.on)
        if dropped:
            lost = f"{percent(*of.range(lambda one: one.rate))} % (rms) of the vibration, which this rate cannot carry"
            what = f"{dropped} of {basis.spectra.samples} bins of {material}, at or above half of {rate_hz} Hz"
            left_out.append(Omission("bins", what, None, None, lost))
    needs.append(f"bins      {_felt(held, protocol)}")
    needs.append(f"fidelity  {budget.most_left_out.sentence(budget.carries_hz, recordings)}")
    return tuple(needs), tuple(left_out)


def _felt(held: Mapping[str, CrinkleSpectra], protocol: Protocol) -> str:
    """Return which bins are asked for: whether those outside the tactile band may be left out, and why."""
    tactile, fastest = protocol.table(Footstep).tactile, preparation.fastest_mm_s(protocol)
    band = f"{tactile.low_hz:g} to {tactile.high_hz:g} Hz"
    if fastest == float("inf"):
        return "all frequencies are requested: trials at any speed count, so none is certain to be below the floor"
    loudest, level = preparation.felt_outside(held, protocol)
    reached = f"reaches {level:.2g} m/s^2 rms at up to {fastest:g} mm/s ({loudest})"
    floor = floor_words(protocol)
    if level >= preparation.floor_m_s2(protocol):
        return f"all frequencies are requested: the part outside {band} {reached}, not below {floor}"
    return f"{band} are requested: the part outside {reached}, below {floor}"


def _bins(spectra: CrinkleSpectra, held: Basis, protocol: Protocol, lost_percent: str) -> Omission:
    """Return what leaving out the bins beyond the tactile band of one material saves and costs."""
    from palpate.experiment.synthesis import crinkle, waveforms

    tactile, fastest = protocol.table(Footstep).tactile, preparation.fastest_mm_s(protocol)
    whole = waveforms.prepare(spectra, material=held.material, output_rate_hz=held.output_rate_hz)
    saves = taken([_summed_ms(whole) - _summed_ms(held) for _ in range(TURNS)])
    loudest = crinkle.rms_outside(spectra, band_hz=tactile.band_hz, fastest_mm_s=fastest)
    lost = (
        f"{lost_percent} % (rms) of the vibration, which reaches {loudest:.2g} m/s^2 rms at up to {fastest:g} mm/s, "
        f"below {floor_words(protocol)}"
    )
    bins = spectra.samples - held.spectra.amplitudes.shape[1]
    band = f"{tactile.low_hz:g} to {tactile.high_hz:g} Hz"
    what = f"{bins} of {spectra.samples} bins of {held.material}, outside {band}"
    return Omission("bins", what, saves, (whole.nbytes - held.nbytes) / 1e3, lost)


def _summed_ms(basis: Basis) -> float:
    """Return the time of one step to its waveform, ms."""
    return _step_ms(lambda speed_mm_s: basis.at(speed_mm_s).waveform_m_s2)


def _step_ms(render: Callable[[float], object]) -> float:
    """Return the time of one step, the mean over `SPEEDS_MM_S`, ms."""
    return sum(ms(partial(render, v)) for v in SPEEDS_MM_S) / len(SPEEDS_MM_S)


def besides(*, scene: Scene, protocol: Protocol, recordings: Path) -> Scene:
    """Return a scene with the materials instead that are recorded and not its own; errors as `load_spectra`."""
    recorded = manifest.materials_of(recordings).difference(scene.materials)
    return replace(scene, materials=tuple(one.id for one in protocol.materials if one.id in recorded))


def floor_words(protocol: Protocol) -> str:
    """Return the floor, m/s^2 rms, or between which those of participants are."""
    own = protocol.table(Footstep).tactile
    low, high = import_module(FLOOR).range_m_s2(protocol) if own.measured else [own.floor_m_s2] * 2
    return f"the floor {high:g}" if low == high else f"the largest floor {high:g} (lowest: {low:g})"
