"""What a board's page says of footsteps."""

from collections.abc import Iterator

from palpate.experiment.protocol.blocks import Block, Quoted, Said, count, number
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.protocol.models import Protocol, Step, Task
from palpate.experiment.protocol.page.words import KindWords

MOVEMENT = "the foot's height (and horizontal position, if measured) over time, the speed and time of each step, "
PRESSED = "A sensor under the panel measures the force of the foot until 0.2 s after contact."
_AVERAGED = {"magnitude": "magnitudes of their spectra", "signed": "signed coefficients of their spectra"}


def _stimuli(protocol: Protocol) -> Iterator[Block]:
    yield from _synthesised(protocol.table(Footstep)) if protocol.renders else ()
    yield from _steps(protocol.table(Footstep).step, ahead=any(task.ahead for task in protocol.tasks))
    if protocol.table(Footstep).force:
        yield Said(PRESSED)


def _synthesised(footstep: Footstep) -> Iterator[Block]:
    synthesis, tactile = footstep.synthesis, footstep.tactile
    speeds = ", ".join(map(number, synthesis.speeds_mm_s))
    yield Said(
        f"Virtual stimuli are made from recordings of the real materials: {count(synthesis.takes, 'take')} at each "
        f"speed ({speeds} mm/s), each with {synthesis.samples} samples at {synthesis.rate_hz} Hz "
        f"({number(synthesis.samples / synthesis.rate_hz)} s). Takes are averaged using the "
        f"{_AVERAGED[synthesis.average]}."
    )
    yield Said(
        f"Frequencies outside {number(tactile.low_hz)} to {number(tactile.high_hz)} Hz are left out of every stimulus "
        f"of a task if together they are below {number(tactile.floor_m_s2)} m/s^2 (rms) in every material; otherwise "
        "all are included. Source:"
    )
    yield Quoted(tactile.source)
    if (measured := tactile.measured) is not None:
        own = measured.whose == "participant"
        yield Said(
            "If it is lower, this limit is instead the weakest vibration (rms, at any frequency) that "
            f"{'the participant' if own else 'anybody'} may have felt in an earlier study: the lower 95 % limit for "
            f"{'the thresholds under their label. Nobody without one takes part' if own else 'any threshold'}. File:"
        )
        yield Quoted(f"{measured.file}, SHA-256 {measured.sha256}")
    yield Said(
        "The protocol does not limit how much of a stimulus a rig may leave out because it cannot reproduce those "
        "frequencies. Each trial's record shows the share left out."
        if synthesis.left_out_max is None
        else f"No session runs on a rig that cannot reproduce more than {synthesis.left_out_max * 100:.10g} % of the "
        "vibration (rms) of any material at any speed that counts, or on a rig whose frequency response is unknown."
    )


def _steps(step: Step, *, ahead: bool) -> Iterator[Block]:
    earlier = " If a task's stimulus begins before contact, that task states its own rule." if ahead else ""
    yield Said(
        f"The speed of the foot is measured while its height falls from {number(step.gate_top_mm)} to "
        f"{number(step.gate_bottom_mm)} mm. The stimulus starts at {number(step.contact_mm)} mm. If the foot stops, "
        f"turns back or hesitates on the way, no stimulus is played and the trial is ready for another step.{earlier}"
    )


def _felt(protocol: Protocol, task: Task) -> str:
    synthesis = protocol.table(Footstep).synthesis
    total_s = number(round(protocol.felt_trials(task) * synthesis.samples / synthesis.rate_hz, 1))
    return f"In task {task.id} vibration lasts {total_s} s in total, if no trial is repeated."


def _odd(protocol: Protocol) -> Iterator[tuple[str, str, str]]:
    high_hz, rate_hz = protocol.table(Footstep).tactile.high_hz, protocol.table(Footstep).synthesis.rate_hz
    if high_hz > rate_hz / 2:
        half = f"usually at most {rate_hz / 2:g}, half the value of footstep.synthesis.rate_hz"
        yield "footstep.tactile.high_hz", f"{high_hz:g}", f"{half}: recordings contain no higher frequencies"


WORDS = KindWords(
    touched=lambda protocol: "vibrating part" if any(task.ahead for task in protocol.tasks) else "panel",
    familiar=lambda _: "nothing vibrates",
    sources={
        "virtual": "virtual: vibration, synthesized from recordings",
        "real": "real: the experimenter lays out the real object before each trial",
    },
    recorded=lambda protocol: MOVEMENT + ("the force of the foot, " if protocol.table(Footstep).force else ""),
    stimuli=_stimuli,
    felt=_felt,
    odd=_odd,
)
