"""What a board's page says of footsteps."""

from collections.abc import Iterator

from palpate.experiment.protocol.blocks import Block, Quoted, Said, count, number
from palpate.experiment.protocol.kinds.footstep import Footstep
from palpate.experiment.protocol.models import Protocol, Step, Task
from palpate.experiment.protocol.page.words import KindWords

MOVEMENT = "the foot's height (and place along the panel, if measured) over time, the speed and time of each step, "
PRESSED = "A sensor under the panel measures how hard the foot presses, until 0.2 s after contact."
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
        f"Virtual stimuli are made from recordings of the real materials: {count(synthesis.takes, 'take')} at each of "
        f"the speeds {speeds} mm/s, each of {synthesis.samples} samples at {synthesis.rate_hz} Hz "
        f"({number(synthesis.samples / synthesis.rate_hz)} s). The average over takes is that of the "
        f"{_AVERAGED[synthesis.average]}."
    )
    yield Said(
        f"Frequencies outside {number(tactile.low_hz)} to {number(tactile.high_hz)} Hz are left out of every stimulus "
        f"of a task if together they stay below {number(tactile.floor_m_s2)} m/s^2 (rms) in every material; otherwise "
        "they all stay in. Source:"
    )
    yield Quoted(tactile.source)
    if (measured := tactile.measured) is not None:
        own = measured.whose == "participant"
        yield Said(
            "In place of that number stands, where it is less, the weakest vibration (rms, at any frequency) that "
            f"{'the participant' if own else 'anybody'} may have felt in an earlier study: the lower limit of the 95 % "
            f"of {'thresholds under their label; nobody without takes part' if own else 'all thresholds'}. File:"
        )
        yield Quoted(f"{measured.file}, SHA-256 {measured.sha256}")
    yield Said(
        "The protocol sets no limit to what a rig may leave out of a stimulus because it cannot carry those "
        "frequencies. Each trial's record says what share was left out."
        if synthesis.left_out_max is None
        else f"No session is run on a rig that leaves out more than {synthesis.left_out_max * 100:.10g} % of the "
        "vibration (rms) of any material, at any speed that counts, because it cannot carry those frequencies, or of "
        "which nobody knows what it carries."
    )


def _steps(step: Step, *, ahead: bool) -> Iterator[Block]:
    earlier = " A task whose stimulus begins before that says what then holds." if ahead else ""
    yield Said(
        f"The speed of the foot is measured while it moves down from {number(step.gate_top_mm)} to "
        f"{number(step.gate_bottom_mm)} mm above the panel, and the stimulus starts when it reaches "
        f"{number(step.contact_mm)} mm. If the foot stops, turns back or hesitates on the way, no stimulus is played "
        f"and the trial is at once made ready (armed) for another step.{earlier}"
    )


def _felt(protocol: Protocol, task: Task) -> str:
    synthesis = protocol.table(Footstep).synthesis
    total_s = number(round(protocol.felt_trials(task) * synthesis.samples / synthesis.rate_hz, 1))
    return f"In task {task.id} the panel vibrates for {total_s} s in all, if no trial is repeated."


def _odd(protocol: Protocol) -> Iterator[tuple[str, str, str]]:
    high_hz, rate_hz = protocol.table(Footstep).tactile.high_hz, protocol.table(Footstep).synthesis.rate_hz
    if high_hz > rate_hz / 2:
        half = f"as a rule at most {rate_hz / 2:g}, half of footstep.synthesis.rate_hz"
        yield "footstep.tactile.high_hz", f"{high_hz:g}", f"{half}: recordings hold no frequency above"


WORDS = KindWords(
    sources={
        "virtual": "virtual: vibration of the panel, synthesised from recordings",
        "real": "real: the experimenter lays out the real object before each trial",
    },
    recorded=lambda protocol: MOVEMENT + ("how hard the foot presses, " if protocol.table(Footstep).force else ""),
    stimuli=_stimuli,
    felt=_felt,
    odd=_odd,
)
