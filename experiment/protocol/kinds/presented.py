"""Presented stimuli in a protocol: what sets one off, what each material's is, and the rules of that."""

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from palpate.experiment.protocol.designs import NAMES, design_of
from palpate.experiment.protocol.kinds import ProtocolKind, number_at, table_at, tables_at
from palpate.experiment.protocol.models import KindTable
from palpate.experiment.settings.load import ONE_LINE, Broken, Confined, Line, Name, Rules, Table

SAMPLE_KEYS = "123456789abcdefghijklmnopqrstuvwxyz"
"""Keys of what is felt in the familiarisation, where materials have none."""

OF_STEPS = ("frames-lost", "speed-below", "speed-above")
"""What only a footstep has, for an exclusion rule to judge."""

Hertz = Annotated[float, Field(gt=0, le=20_000)]
Peak = Annotated[float, Field(ge=0, le=100)]
Lasts = Annotated[float, Field(gt=0, le=10)]


class Sinusoid(Confined):
    """A sinusoid, which begins at zero.

    Attributes:
        frequency_hz: frequency.
        amplitude_m_s2: peak.
        lasts_s: duration.
    """

    frequency_hz: Hertz
    amplitude_m_s2: Peak
    lasts_s: Lasts


class Decaying(Confined):
    """A sinusoid that decays as exp(-t B).

    Attributes:
        frequency_hz: frequency.
        amplitude_m_s2: peak, without decay.
        decay_per_s: B.
        lasts_s: duration.
    """

    frequency_hz: Hertz
    amplitude_m_s2: Peak
    decay_per_s: Annotated[float, Field(gt=0, le=10_000)]
    lasts_s: Lasts


def _noise_rules(table: Table) -> Iterator[Broken]:
    """`high_hz` is greater than `low_hz`."""
    low, high = number_at(table, "low_hz"), number_at(table, "high_hz")
    if low is not None and high is not None and high <= low:
        yield Broken(("high_hz",), f"a number greater than low_hz ({low})")


class Noise(Confined):
    """A burst of noise with a flat spectrum in a band, identical each time.

    Attributes:
        low_hz: start of the band.
        high_hz: its end.
        rms_m_s2: rms.
        seed: seed for its phases.
        lasts_s: duration.
    """

    RULES: ClassVar[Rules] = _noise_rules

    low_hz: Hertz
    high_hz: Hertz
    rms_m_s2: Peak
    seed: Annotated[int, Field(ge=0, le=2**31)]
    lasts_s: Lasts


class Sweep(Confined):
    """A sinusoid that sweeps between two frequencies.

    Attributes:
        from_hz: first frequency.
        to_hz: last frequency.
        amplitude_m_s2: peak.
        by: unit in which the sweep rate is constant.
        lasts_s: duration.
    """

    from_hz: Hertz
    to_hz: Hertz
    amplitude_m_s2: Peak
    by: Literal["hertz", "octaves"]
    lasts_s: Lasts


def _pulses_rules(table: Table) -> Iterator[Broken]:
    """A cycle of `cycle_hz` ends before the next pulse, and by `lasts_s`."""
    every, cycle, lasts = (number_at(table, key) for key in ("every_s", "cycle_hz", "lasts_s"))
    if every is not None and cycle and every * cycle < 1:
        yield Broken(("every_s",), f"at least one cycle of cycle_hz ({1 / cycle:g} s)")
    if lasts is not None and cycle and lasts * cycle < 1:
        yield Broken(("lasts_s",), f"at least one cycle of cycle_hz ({1 / cycle:g} s)")


class Pulses(Confined):
    """A train of pulses, each one cycle of a sinusoid.

    Attributes:
        every_s: time from pulse to pulse.
        cycle_hz: frequency of a cycle.
        amplitude_m_s2: peak.
        lasts_s: duration; only pulses that end within it are played.
    """

    RULES: ClassVar[Rules] = _pulses_rules

    every_s: Lasts
    cycle_hz: Hertz
    amplitude_m_s2: Peak
    lasts_s: Lasts


class Recorded(Confined):
    """A recorded acceleration without its mean, from a WAV file in the protocol's folder.

    Attributes:
        file: the name of the file.
        sha256: its hash, so that the protocol's hash identifies the recording.
        full_scale_m_s2: the acceleration of a sample of full scale.
        begins_s: where in the file it begins.
        lasts_s: how long it lasts.
    """

    file: Annotated[
        str,
        Field(pattern=r"^[^/\\\s.][^/\\\s]*\.wav$", description="the name of a .wav file in the protocol's folder"),
        ONE_LINE,
    ]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$", description="64 hexadecimal digits, as sha256sum prints")]
    full_scale_m_s2: Annotated[float, Field(gt=0, le=10_000)]
    begins_s: Annotated[float, Field(ge=0)] = 0.0
    lasts_s: Lasts


class Silence(Confined):
    """A gap, or no stimulus.

    Attributes:
        lasts_s: duration.
    """

    lasts_s: Lasts


WAVES = ("sinusoid", "decaying", "noise", "sweep", "pulses", "recorded", "silence")
"""What a part may be, by its table."""

STATED = ("sinusoid", "decaying", "sweep", "pulses", "silence")
"""Those of which the protocol states the peak."""


def _part_rules(table: Table) -> Iterator[Broken]:
    """A part is exactly one wave, and includes both ramps."""
    stated = [name for name in WAVES if table.get(name) is not None]
    if len(stated) != 1:
        yield Broken((stated[1] if stated else WAVES[0],), f"exactly one of the tables {', '.join(WAVES)}")
        return
    lasts, ramp = number_at(table_at(table, stated[0]), "lasts_s"), number_at(table, "ramp_s")
    if lasts is not None and ramp is not None and 2 * ramp > lasts:
        yield Broken(("ramp_s",), f"at most half of {stated[0]}.lasts_s ({lasts / 2:g})")


class Part(Confined):
    """A part of a stimulus: one wave, which follows the previous one without a gap.

    Attributes:
        ramp_s: rise and fall, a raised cosine.
        sinusoid: a sinusoid.
        decaying: a sinusoid that fades.
        noise: a burst of noise in a band.
        sweep: a sinusoid of which the frequency changes.
        pulses: a train of pulses.
        recorded: a recorded waveform.
        silence: nothing.
    """

    RULES: ClassVar[Rules] = _part_rules

    ramp_s: Annotated[float, Field(ge=0, le=5)] = 0.0
    sinusoid: Sinusoid | None = None
    decaying: Decaying | None = None
    noise: Noise | None = None
    sweep: Sweep | None = None
    pulses: Pulses | None = None
    recorded: Recorded | None = None
    silence: Silence | None = None

    @property
    def wave(self) -> tuple[str, Confined]:
        """Which wave it is, and its table."""
        return next((name, own) for name in WAVES if (own := getattr(self, name)) is not None)

    @property
    def lasts_s(self) -> float:
        """How long it lasts, s."""
        lasts_s: float = getattr(self.wave[1], "lasts_s")  # noqa: B009
        return lasts_s


class Site(Confined):
    """A site of the body, with an actuator of its own.

    Attributes:
        name: of the site, as in `[[sites]]` of a rig.
        place: where on the body.
        peak_m_s2: largest acceleration there.
    """

    name: Name
    place: Line
    peak_m_s2: Annotated[float, Field(gt=0, le=100)]


class PresentedStimulus(Confined):
    """A material's stimulus.

    Attributes:
        material: whose stimulus it is.
        site: where it is felt, with `[[presented.sites]]`.
        parts: what it is made of, one after the other.
    """

    material: Name
    site: Name | None = None
    parts: Annotated[tuple[Part, ...], Field(min_length=1)]

    @property
    def lasts_s(self) -> float:
        """How long it lasts, s."""
        return sum(part.lasts_s for part in self.parts)


class Presented(KindTable):
    """Settings for trials of the kind `presented`.

    Attributes:
        set_off: what starts a stimulus: someone's key, or the clock.
        gap_s: shortest time from an answer to the next stimulus.
        pause_s: between the stimuli of a trial, if there are several.
        left_out_max: largest share (rms) of a stimulus that a rig may leave out; rigs that leave out more or were not
            measured are refused.
        sites: of the body, if stimuli are felt at several.
        stimuli: what is played for each material.
    """

    set_off: Literal["experimenter", "participant", "clock"]
    gap_s: Annotated[float, Field(ge=0, le=60)]
    pause_s: Annotated[float, Field(ge=0.2, le=10)] | None = None
    left_out_max: Annotated[float, Field(gt=0, le=1)] | None = None
    sites: tuple[Site, ...] = ()
    stimuli: Annotated[tuple[PresentedStimulus, ...], Field(min_length=1)]

    @property
    def limits_m_s2(self) -> dict[str | None, float]:
        """The largest acceleration at each site; empty without any."""
        return {one.name: one.peak_m_s2 for one in self.sites}

    @property
    def site_of(self) -> dict[str, str | None]:
        """The site of each material's stimulus."""
        return {one.material: one.site for one in self.stimuli}

    @property
    def trial_s(self) -> float:
        longest_s = max(one.lasts_s for one in self.stimuli)
        return longest_s if self.pause_s is None else 2 * longest_s + self.pause_s

    @property
    def peaks_m_s2(self) -> dict[str, float]:
        waves = {one.material: [part.wave for part in one.parts] for one in self.stimuli}
        known = {material: own for material, own in waves.items() if all(name in STATED for name, _ in own)}
        return {material: max(getattr(it, "amplitude_m_s2", 0.0) for _, it in own) for material, own in known.items()}

    @property
    def numbers(self) -> dict[str, dict[str, float]]:
        waves = {one.material: one.parts[0].wave for one in self.stimuli if len(one.parts) == 1}
        return {
            material: {key: float(value) for key, value in own if isinstance(value, int | float)}
            for material, (name, own) in waves.items()
            if name in STATED
        }

    @property
    def companions(self) -> dict[str, str]:
        """The recordings that it names, each with its SHA-256."""
        parts = (part.recorded for one in self.stimuli for part in one.parts)
        return {recorded.file: recorded.sha256 for recorded in parts if recorded is not None}


def _rules(table: Table) -> Iterator[Broken]:
    """The kind `presented` needs `[presented]`, with a stimulus for each material, and `pause_s` if a trial has several
    stimuli. Its tasks are `virtual`; no amplitude is above `exposure.vibration_peak_m_s2`; `masker.probe` is omitted.
    With `sites`, each stimulus has one, and each site a stimulus; its `peak_m_s2` limits their amplitudes.
    """
    if table.get("presented") is None:
        yield Broken(("presented",), "a table, because tasks of the kind 'presented' need it")
    own = table_at(table, "presented")
    if table_at(table, "masker").get("probe") is not None:
        yield Broken(("masker", "probe"), "no table: a probe imitates a footstep, and this study has no footsteps")
    for i, rule in tables_at(table, "exclusion"):
        if rule.get("when") in OF_STEPS:
            yield Broken(
                ("exclusion", i, "when"), "one of: undelivered, answers-below, withdrawn, in a study without steps"
            )
    for i, task in tables_at(table, "tasks"):
        if task.get("stimulus") == "real":
            yield Broken(("tasks", i, "stimulus"), "virtual: in tasks of this kind, the rig plays every stimulus")
        design = str(task.get("design"))
        several = design in NAMES and design_of(design).shown_together(table_at(table, design)) > 1
        if several and own and own.get("pause_s") is None:
            allowed = "a number of seconds, because trials of this design present several stimuli"
            yield Broken(("presented", "pause_s"), allowed)
    yield from _stimuli(table, own)


def _stimuli(table: Table, own: Table) -> Iterator[Broken]:
    ids = [one.get("id") for _, one in tables_at(table, "materials")]
    had = [one.get("material") for _, one in tables_at(own, "stimuli")]
    if own and (without := [str(one) for one in ids if one not in had]):
        yield Broken(("presented", "stimuli"), f"one for each material; missing: {', '.join(without)}")
    peak, hashes = number_at(table_at(table, "exposure"), "vibration_peak_m_s2"), dict[object, object]()
    yield from _sites(own, peak)
    for i, one in tables_at(own, "stimuli"):
        if had[i] not in ids or had[i] in had[:i]:
            allowed = f"one of the materials, each once: {', '.join(map(str, ids))}"
            yield Broken(("presented", "stimuli", i, "material"), allowed)
        for j, part in tables_at(one, "parts"):
            recorded = table_at(part, "recorded")
            sha256 = recorded.get("sha256")
            if (first := hashes.setdefault(recorded.get("file"), sha256)) != sha256:
                place = ("presented", "stimuli", i, "parts", j, "recorded", "sha256")
                yield Broken(place, f"the same value everywhere for this file ({first})")
            for name in WAVES:
                strongest = number_at(table_at(part, name), "amplitude_m_s2")
                if peak is not None and strongest is not None and strongest > peak:
                    place = ("presented", "stimuli", i, "parts", j, name, "amplitude_m_s2")
                    yield Broken(place, f"at most exposure.vibration_peak_m_s2 ({peak:g})")


def _sites(own: Table, peak: float | None) -> Iterator[Broken]:
    """Yield what is wrong with the sites of the body, of which `own` has the stimuli."""
    limits: dict[object, float | None] = {}
    used = [one.get("site") for _, one in tables_at(own, "stimuli")]
    for i, site in tables_at(own, "sites"):
        name, limit = site.get("name"), number_at(site, "peak_m_s2")
        if name in limits:
            yield Broken(("presented", "sites", i, "name"), "a unique name")
        elif name not in used:
            yield Broken(("presented", "sites", i, "name"), "the site of a stimulus")
        if peak is not None and limit is not None and limit > peak:
            place = ("presented", "sites", i, "peak_m_s2")
            yield Broken(place, f"at most exposure.vibration_peak_m_s2 ({peak:g})")
        limits[name] = limit
    for i, one in tables_at(own, "stimuli"):
        if (named := one.get("site")) not in (limits or (None,)):
            allowed = f"one of presented.sites: {', '.join(map(str, limits))}" if limits else "no site"
            yield Broken(("presented", "stimuli", i, "site"), allowed)
        least = limits.get(named)
        for j, part in tables_at(one, "parts"):
            for name in WAVES:
                strongest = number_at(table_at(part, name), "amplitude_m_s2")
                if least is not None and strongest is not None and strongest > least:
                    wave = ("presented", "stimuli", i, "parts", j, name, "amplitude_m_s2")
                    yield Broken(wave, f"at most the peak_m_s2 of {named} ({least:g})")


def _silent(table: Table) -> list[object]:
    stimuli = [one for _, one in tables_at(table_at(table, "presented"), "stimuli")]
    return [one.get("material") for one in stimuli if all(part.get("silence") for _, part in tables_at(one, "parts"))]


KIND = ProtocolKind(table=Presented, since=7, intervals=(1, 2), rules=_rules, silent=_silent)
