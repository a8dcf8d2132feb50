"""Other engines beside our exact stepper, on the same impacts: run `python -m tests.benchmarks.engines FOLDER`.

It needs MuJoCo, Drake and PyBullet, which are no dependencies: install them by hand (`pip install mujoco drake
pybullet`). A ball on a rail without gravity meets the face of a block with a spring and a damper at 0.2 m/s; the error
is that of its rebound, relative to the closed form of a block that never pulls, the largest of five phases of the touch
within a step. Time is that of one impact, simulation and nothing else; MuJoCo's, Drake's and PyBullet's are of
their Python bindings, ours and scipy's of Python. All is SIMULATED.

Each engine gets what it documents for a linear spring and damper: MuJoCo `solref` = (-K / M, -C / M) with an impedance
of 1 (0.9999 is the most that it takes), which pulls at the end of a contact until its solver lets go; Drake's discrete
SAP a `point_stiffness` and a `relaxation_time` C / K; PyBullet `contactStiffness` and `contactDamping`.

Not a test: it asserts nothing, because these figures belong to the machine that printed them.
"""

from __future__ import annotations

import csv
import logging
import sys
import time
from collections.abc import Callable, Mapping
from functools import partial
from importlib import metadata
from math import inf, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from scipy.integrate import solve_ivp

from palpate.analysis.documents.drawing import COLOURS, marker, svg
from palpate.analysis.numerics import contact, oracle
from palpate.experiment.synthesis.stepping.steppers import EXACT, STEPPERS

SPEED_M_S, DAMPING_RATIO, RADIUS_M = 0.2, 0.2, 0.01
DIAGRAMS = ((4.5e3, 0.1), (1.6e5, 0.1), (1.6e6, 5e-3))
"""Stiffness, N/m, and mass, kg."""

PARTS = (8, 32, 128, 512)
"""Steps a contact; and that of the servo, 400 us."""

PHASES = (0.0, 0.13, 0.37, 0.59, 0.83)

Impact = Callable[[float, float, float, float, float], tuple[float, float]]
"""K, C, M, step, s, and phase -> rebound, m/s, 0 for none, and the time that it took, s."""


def mujoco(k: float, c: float, m: float, step_s: float, phase: float) -> tuple[float, float]:
    import mujoco as engine

    model = engine.MjModel.from_xml_string(
        f"""<mujoco><option timestep="{step_s}" gravity="0 0 0"/><worldbody>
        <geom type="plane" size="1 1 1" priority="1" condim="1" solref="{-k / m} {-c / m}"
        solimp="0.9999 0.9999 1 .5 1"/>
        <body pos="0 0 {RADIUS_M + phase * step_s * SPEED_M_S}"><joint type="slide" axis="0 0 1"/>
        <geom type="sphere" size="{RADIUS_M}" mass="{m}"/></body></worldbody></mujoco>"""
    )
    data = engine.MjData(model)
    data.qvel[0] = -SPEED_M_S
    return _run(
        lambda: engine.mj_step(model, data), lambda: (float(data.qpos[0]) + phase * step_s * SPEED_M_S, data.qvel[0])
    )


def drake(k: float, c: float, m: float, step_s: float, phase: float) -> tuple[float, float]:
    from pydrake import geometry, math
    from pydrake.multibody import plant as plants
    from pydrake.multibody import tree
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder

    builder = DiagramBuilder()
    plant, _ = plants.AddMultibodyPlantSceneGraph(builder, step_s)
    plant.set_discrete_contact_approximation(plants.DiscreteContactApproximation.kSap)
    ball = plant.AddRigidBody("ball", tree.SpatialInertia.SolidSphereWithMass(m, RADIUS_M))
    plant.AddJoint(tree.PrismaticJoint("rail", plant.world_frame(), ball.body_frame(), [0, 0, 1]))
    for body, shape, stiffness, relaxes_s in (
        (plant.world_body(), geometry.HalfSpace(), k, c / k),
        (ball, geometry.Sphere(RADIUS_M), 1e6 * k, 0.0),
    ):
        made = geometry.ProximityProperties()
        geometry.AddContactMaterial(point_stiffness=stiffness, friction=plants.CoulombFriction(0, 0), properties=made)
        made.AddProperty("material", "relaxation_time", relaxes_s)
        plant.RegisterCollisionGeometry(body, math.RigidTransform(), shape, body.name(), made)
    plant.mutable_gravity_field().set_gravity_vector([0, 0, 0])
    plant.Finalize()
    simulator = Simulator(builder.Build())
    at = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetPositions(at, [RADIUS_M + phase * step_s * SPEED_M_S])
    plant.SetVelocities(at, [-SPEED_M_S])
    simulator.Initialize()
    return _run(
        lambda: simulator.AdvanceTo(at.get_time() + step_s),
        lambda: (plant.GetPositions(at)[0] - RADIUS_M, plant.GetVelocities(at)[0]),
    )


def pybullet(k: float, c: float, m: float, step_s: float, phase: float) -> tuple[float, float]:
    import pybullet as engine

    client = engine.connect(engine.DIRECT)
    engine.setGravity(0, 0, 0)
    engine.setTimeStep(step_s)
    floor = engine.createMultiBody(0, engine.createCollisionShape(engine.GEOM_PLANE))
    shape = engine.createCollisionShape(engine.GEOM_SPHERE, radius=RADIUS_M)
    ball = engine.createMultiBody(m, shape, basePosition=[0, 0, RADIUS_M + phase * step_s * SPEED_M_S])
    still = {"linearDamping": 0, "angularDamping": 0, "lateralFriction": 0, "restitution": 0}
    engine.changeDynamics(floor, -1, contactStiffness=k, contactDamping=c, **still)
    engine.changeDynamics(ball, -1, contactStiffness=1e18, contactDamping=0, **still)
    engine.resetBaseVelocity(ball, [0, 0, -SPEED_M_S])
    try:
        return _run(
            engine.stepSimulation,
            lambda: (
                engine.getBasePositionAndOrientation(ball)[0][2] - RADIUS_M,
                engine.getBaseVelocity(ball)[0][2],
            ),
        )
    finally:
        engine.disconnect(client)


def _run(step: Callable[[], object], at: Callable[[], tuple[float, float]]) -> tuple[float, float]:
    """Step until a ball, m above the face and m/s upward, has left; the time is that of the steps alone."""
    took_ns = 0
    for _ in range(contact.MOST):
        begun = time.perf_counter_ns()
        step()
        took_ns += time.perf_counter_ns() - begun
        height, rate = at()
        if rate > 0 and height > 0:
            return rate, took_ns * 1e-9
    return 0.0, inf


def integrated(
    method: str, k: float, c: float, m: float, step_s: float, phase: float, tolerance: float | None = None
) -> tuple[float, float]:
    """Step by `solve_ivp`, which finds where the block would pull; without a tolerance in steps of `step_s`."""

    def rate(_: float, y: Any) -> list[float]:
        return [y[1], -(k * y[0] + c * y[1]) / m if y[0] > 0 else 0.0]

    def lets_go(_: float, y: Any) -> float:
        return float(k * y[0] + c * y[1]) if y[0] > 0 else 1.0

    lets_go.terminal, lets_go.direction = True, -1  # type: ignore[attr-defined]
    given = {"max_step": step_s, "rtol": 1e3, "atol": 1e3} if tolerance is None else {"rtol": tolerance, "atol": 1e-18}
    begun = time.perf_counter_ns()
    found = solve_ivp(rate, (0.0, 1.0), [-phase * step_s * SPEED_M_S, SPEED_M_S], method, events=lets_go, **given)
    took = (time.perf_counter_ns() - begun) * 1e-9
    return (float(-found.y[1, -1]), took) if found.status == 1 else (0.0, inf)


def ours(k: float, c: float, m: float, step_s: float, phase: float) -> tuple[float, float]:
    """Step exactly."""
    block = contact.block_of(stiffness=k, damping_ratio=c / (2 * sqrt(k * m)), mass=m, step_s=step_s)
    begun = time.perf_counter_ns()
    seen = contact.impact(block, STEPPERS[EXACT], speed=SPEED_M_S, step_s=step_s, phase=phase)
    took = (time.perf_counter_ns() - begun) * 1e-9
    return (-seen[-1].deep_m_s, took) if seen and seen[-1].kind == "release" else (0.0, inf)


ENGINES: Mapping[str, Impact] = {
    "MuJoCo": mujoco,
    "Drake, SAP": drake,
    "PyBullet": pybullet,
    "solve_ivp, RK45, steps": partial(integrated, "RK45"),
    "palpate, exact": ours,
}
TOLERANCES = (1e-3, 1e-6, 1e-9, 1e-12)


def measured(run: Impact, k: float, m: float, step_s: float) -> tuple[float, float]:
    """Return the largest error of the rebound over the phases, and the median time of an impact, s."""
    c = 2 * DAMPING_RATIO * sqrt(k * m)
    wanted = float(oracle.impact(stiffness=k, damping_ratio=DAMPING_RATIO, mass=m, speed=SPEED_M_S).rebound_m_s)
    found = [run(k, c, m, step_s, phase) for phase in PHASES]
    error = max(abs(rebound / wanted - 1) for rebound, _ in found)
    return error, float(np.median([took for _, took in found]))


def rows() -> list[dict[str, Any]]:
    """Measure every engine at every step of each diagram."""
    made = []
    for k, m in DIAGRAMS:
        lasts_s = contact.contact_s(stiffness=k, mass=m)
        points = [(name, run, step, "") for name, run in ENGINES.items()
                  for step in (*(lasts_s / n for n in PARTS), contact.SERVO_S)]  # fmt: skip
        points += [
            ("solve_ivp, DOP853, tolerance", partial(integrated, "DOP853", tolerance=one), lasts_s, f"{one:g}")
            for one in TOLERANCES
        ]
        for name, run, step_s, tolerance in points:
            error, took_s = measured(run, k, m, step_s)
            row = {"engine": name, "stiffness_n_m": k, "mass_kg": m, "step_us": f"{step_s * 1e6:.4g}"}
            row |= {"tolerance": tolerance, "error": f"{error:.2e}", "time_us": f"{took_s * 1e6:.4g}"}
            made.append(row)
            print(made[-1], flush=True)
    return made


def drawn(made: list[dict[str, Any]]) -> Figure:
    """Error against time, a panel for each stiffness."""
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    for axes, (k, m) in zip(figure.subplots(1, len(DIAGRAMS), sharey=True), DIAGRAMS, strict=True):
        for n, name in enumerate(dict.fromkeys(row["engine"] for row in made)):
            of = [row for row in made if (row["engine"], row["stiffness_n_m"]) == (name, k)]
            at = [(float(row["time_us"]), max(float(row["error"]), 1e-16)) for row in of if row["time_us"] != "inf"]
            axes.plot(*zip(*sorted(at), strict=True), marker(n), color=COLOURS[n], label=name, ms=4, lw=0.8)
        axes.set(xscale="log", yscale="log", title=f"{k:g} N/m, {m:g} kg", xlabel="time of an impact (µs)")
        axes.xaxis.set_major_formatter(FuncFormatter(lambda us, _: f"{us:g}"))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda error, _: f"{error:g}"))
    figure.axes[0].set_ylabel("relative error of the rebound")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle("SIMULATED impacts: each engine in steps of a contact's 1/8 to 1/512, and of 400 µs")
    return figure


def main() -> None:
    """Measure, and write the table and the picture into a folder."""
    logging.getLogger("drake").setLevel(logging.ERROR)
    folder = Path(sys.argv[1])
    made = rows()
    with (folder / "engines.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, made[0], lineterminator="\n")
        table.writeheader()
        table.writerows(made)
    (folder / "engines.svg").write_bytes(svg(drawn(made)))
    print({name: metadata.version(name) for name in ("mujoco", "drake", "pybullet", "scipy", "palpate")})


if __name__ == "__main__":
    main()
