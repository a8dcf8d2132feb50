"""The SIMULATED hand is where the force takes it that the servo makes of its samples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim

from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.rig import tracker_of
from palpate.experiment.apparatus.servo import rendering
from palpate.experiment.apparatus.servo.rendering import NO_FORCE, Rendered, bounded
from palpate.experiment.apparatus.tracker.frames import Decoder
from palpate.experiment.apparatus.tracker.settings import CalibrationPoint, TrackerRig
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.kinds.tapping import hand, pushed
from tests.experiment.rehearsal.wires.test_foot import Recorder


def test_the_force_of_its_own_samples_moves_it() -> None:
    rig = rigs.load(shipped("rigs/tapping.toml"))
    device = pushed.device_of(files.load(shipped("wellman1995.toml")), rig)
    meant = hand.tap(np.random.default_rng(2))
    moved = pushed.moved(meant, device)
    # What its tracker sends, sample by sample.
    line = Recorder()
    foot = hand.moves(line, rig, real_time=False)
    foot.step(moved, 0)
    foot.finish()
    foot.close()
    _, frames = Decoder(period_us=400, readings=2).feed(line.data)
    along_mm = device.tracker.along_mm(frames.along)
    assert along_mm is not None
    places_mm = zip(device.tracker.height_mm(frames.counts).tolist(), along_mm.tolist(), strict=True)
    at, sent_n, forces = Rendered(), NO_FORCE, []
    for us, place_mm in zip(frames.device_us.tolist(), places_mm, strict=True):
        at, _ = rendering.step(device.block, at, us, place_mm, device.observer, sent_n, device.limit_n)
        sent_n = bounded(at.force_n, device.limit_n)
        forces.append(sent_n)
    assert max(out for out, _ in forces) > 1.0
    # 0.1 kg and 5 N s/m of the rig; 10 g, 2 N s/m and 300 N/m of the hand.
    kg, damping, stiffness = 0.11, 7.0, 300.0
    plant = np.array([[0, 1], [-stiffness / kg, -damping / kg]]), np.array([[0], [1e3 / kg]])
    discrete = cont2discrete((*plant, np.eye(2)[:1], np.zeros((1, 1))), 1 / 2500)
    us = frames.device_us - float(frames.device_us[0])
    for axis, off_mm in enumerate((moved.at(us) - meant.at(us), moved.along_at(us) - meant.along_at(us))):
        _, wanted_mm, _ = dlsim(discrete, np.array(forces)[:, axis])
        assert off_mm == pytest.approx(wanted_mm[:, 0], abs=2 * pushed.LITTLE_MM)
        assert np.abs(off_mm).max() > 0.05


@pytest.mark.parametrize("planar", [False, True])
def test_one_place_is_read_as_many_are(planar: bool) -> None:
    """From a sensor that falls, with a bend, beyond both of its ends too."""
    bent = tuple(CalibrationPoint(counts=counts, mm=mm) for counts, mm in ((200, 31.0), (1500, 7.3), (4000, -2.1)))
    along = (
        tuple(CalibrationPoint(counts=counts, mm=mm) for counts, mm in ((0, -40.0), (3000, 55.5))) if planar else None
    )
    table = tracker_of(rigs.load(shipped("rigs/tapping.toml"))).model_dump()
    tracker = TrackerRig.model_validate({**table, "calibration": bent, "along_calibration": along})
    rng = np.random.default_rng(1)
    places, noise = rng.uniform(-60.0, 60.0, (2000, 2)), rng.normal(0.0, 0.1, (tracker.readings, 2000))
    places[:3, 0], noise[:, :3] = (31.0, 7.3, -2.1), 0.0
    wanted = pushed.read_all(tracker, places, noise)
    read = pushed.one_read(tracker)
    assert [read(place, each) for place, each in zip(places.tolist(), noise.T.tolist(), strict=True)] == list(
        map(tuple, wanted.tolist())
    )
