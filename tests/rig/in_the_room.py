"""A session with a participant whose devices are SIMULATED: foot, panel, masker and microphone, and who answers."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from typing import Any
from unittest import mock

from palpate.experiment.desk.voice.listening import Listening
from palpate.experiment.rehearsal.practice import Guided
from palpate.experiment.rehearsal.session import Job, SimulatedEnds
from palpate.experiment.session import laboratory, run
from palpate.experiment.session.attempt import Devices
from palpate.experiment.session.kind import FarEnds, Sitting
from tests.experiment.session.test_masking import ScriptedMasker
from tests.experiment.session.test_spoken import ScriptedMicrophone

SEED = 1


@contextmanager
def _opened(sitting: Sitting, ends: FarEnds) -> Iterator[Devices]:
    clock: Any = sitting.clock
    job = Job(sitting.dataset, sitting.participant, (sitting.task_id,), SEED, "none", real_time=True)
    world = SimulatedEnds(job, sitting, lambda: None, None, Guided(ends.console(), first=False))
    with laboratory.open_laboratory(sitting, world) as devices, ThreadPoolExecutor(1) as computing:
        yield replace(devices, masker=ScriptedMasker(clock), listening=Listening(ScriptedMicrophone(clock), computing))


def simulate() -> None:
    """Have the sessions of this process meet simulated devices."""
    mock.patch.object(run, "open_laboratory", _opened).start()
