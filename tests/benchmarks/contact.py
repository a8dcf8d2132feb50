"""What a contact costs: run `python -m tests.benchmarks.contact`; every ratio is of one run.

First the time of one step of a 2.5 kHz servo, in the plane, through the hand's samples, at their nominal distance and
with jittered times. Then the run time of one impact at an equal error of 1e-6 in the speed of rebound, the largest over
the phase of the touch, for the exact stepper, for RK4, and for RK4 with the events located: each with the longest step
that reaches it. Not a test: it asserts nothing, because these figures belong to the machine that printed them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from palpate.analysis.numerics.contact import (
    DAMPING_RATIO,
    PHASES,
    SERVO_S,
    SPEED_M_S,
    block_of,
    contact_s,
    errors,
)
from palpate.experiment.synthesis.contact.block import FREE, Advance, Block, Motion, Switch
from palpate.experiment.synthesis.contact.path import init, step
from palpate.experiment.synthesis.stepping.steppers import STEPPERS

STEPS = 20_000
STIFFNESS_N_M, MASS_KG = 4500.0, 0.1
EQUAL_ERROR = 1e-6
ROUNDS = 30
GIVEN = {"stiffness": STIFFNESS_N_M, "damping_ratio": DAMPING_RATIO, "mass": MASS_KG, "speed": SPEED_M_S}


def servo_us(blocks: list[Block], *, inside: bool, jitter: float) -> tuple[float, float]:
    """Return the median and the 99.9th percentile of one step, us; the hand is in every block, or outside of all."""
    rng = np.random.default_rng(1)
    state = init(blocks, hand_m=(-1e-3, 0.0))
    taken = []
    for n in range(1, STEPS):
        dt = SERVO_S * (1 + jitter * float(rng.uniform(-1, 1))) if jitter else SERVO_S
        x = (0.003 if inside else -0.003) + 0.001 * math.sin(0.01 * n) * (n > 20)
        hand = (x, 0.001 * math.sin(0.003 * n))
        begun = time.perf_counter_ns()
        made = step(blocks, state, hand_m=hand, dt_s=dt)
        taken.append(time.perf_counter_ns() - begun)
        state = made.state
    middle, late = np.quantile(taken, [0.5, 0.999]) / 1e3
    return float(middle), float(late)


def one_impact(block: Block, once: Advance, step_s: float, phase: float) -> list[Switch]:
    at, seen = Motion(FREE, -phase * step_s * SPEED_M_S, SPEED_M_S), list[Switch]()
    while True:
        at, switches = once(block, at, step_s)
        if switches:
            seen += switches
            if switches[-1].kind == "release":
                return seen


def at_equal_error(method: str, first: int, factor: float) -> tuple[Callable[[], object], int, float]:
    """Return the impact in as few steps as reach `EQUAL_ERROR`, how many a contact takes, and its error."""
    lasts, steps, once = contact_s(stiffness=STIFFNESS_N_M, mass=MASS_KG), first, STEPPERS[method]
    while True:
        step_s = lasts / steps if steps else 2 * lasts
        block = block_of(stiffness=STIFFNESS_N_M, damping_ratio=DAMPING_RATIO, mass=MASS_KG, step_s=step_s)
        phases = PHASES if steps < 10_000 else PHASES[:2]
        worst = max(errors(one_impact(block, once, step_s, phase), **GIVEN)["rebound"] for phase in phases)
        if worst <= EQUAL_ERROR:
            return partial(one_impact, block, once, step_s, PHASES[1]), steps, worst
        steps = math.ceil(steps * factor)


def main() -> None:
    def made(count: int) -> list[Block]:
        return [Block((2500.0, 500.0), (10.0, 2.0), (math.inf, math.inf), nominal_s=SERVO_S) for _ in range(count)]

    given = [Block((2500.0, 500.0), (10.0, 2.0), (50.0, 50.0), nominal_s=SERVO_S)]
    print(f"one step of the servo, {STEPS} each: median, 99.9th percentile")
    for name, blocks, inside, jitter in (
        ("1 block, touched", made(1), True, 0.0),
        ("1 block that gives way, touched", given, True, 0.0),
        ("1 block that gives way, jittered times", given, True, 0.1),
        ("1 block, not touched", made(1), False, 0.0),
        ("10 blocks, all touched", made(10), True, 0.0),
        (
            "10 blocks, 1 touched",
            [*made(1), *(Block((2500.0, 0.0), (10.0, 0.0), (1.0, 1.0), face_m=(1.0, 0.0)) for _ in range(9))],
            True,
            0.0,
        ),
    ):
        middle, late = servo_us(blocks, inside=inside, jitter=jitter)
        print(f"  {name:40s} {middle:8.2f} us {late:8.2f} us")
    print(f"one impact on {STIFFNESS_N_M:g} N/m, {MASS_KG:g} kg, at {EQUAL_ERROR:g} in the speed of rebound")
    calls = {
        "exact": at_equal_error("exact", 0, 1),
        "rk4 with events": at_equal_error("rk4 with events", 8, 1.2),
        "rk4": at_equal_error("rk4", 60_000, 2),
    }
    taken: dict[str, list[int]] = {name: [] for name in calls}
    for turn in range(ROUNDS):
        for name, (call, _, _) in calls.items():
            if name == "rk4" and turn >= 3:
                continue
            begun = time.perf_counter_ns()
            call()
            taken[name].append(time.perf_counter_ns() - begun)
    took = {name: float(np.median(times)) / 1e3 for name, times in taken.items()}
    for name, (_, steps, worst) in calls.items():
        print(f"  {name:16s} {steps:8d} steps a contact, error {worst:.1e}, {took[name]:12.1f} us")
    print(f"rk4 / exact                  {took['rk4'] / took['exact']:12.0f}   (at least 100)")
    print(f"rk4 with events / exact      {took['rk4 with events'] / took['exact']:12.1f}   (at least 10)")


if __name__ == "__main__":
    main()
