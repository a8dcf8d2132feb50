"""A real TCP stream of samples: to the simulated panel, to servers that fail, and to PulseAudio."""

from __future__ import annotations

import hashlib
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from palpate.experiment.apparatus import opening
from palpate.experiment.apparatus import rig as rigs
from palpate.experiment.apparatus.doctor import checks
from palpate.experiment.apparatus.panel import pcm as pcm_ports
from palpate.experiment.apparatus.panel.conditioning import Conditioner, Played, open_drive
from palpate.experiment.apparatus.panel.pcm import PcmActuator
from palpate.experiment.apparatus.ports import Actuator
from palpate.experiment.apparatus.rig import ActuatorRig, ShapingRig
from palpate.experiment.errors import ActuatorError
from palpate.experiment.protocol import files
from palpate.experiment.protocol.files import shipped
from palpate.experiment.rehearsal.kinds.footstep import recorded_takes
from palpate.experiment.rehearsal.wires import panel as response
from palpate.experiment.rehearsal.wires.panel import Panel
from palpate.experiment.session import scene
from palpate.experiment.session.kinds.footstep import preparation
from palpate.experiment.synthesis.spectra import bin_frequencies_hz, spectrum
from palpate.experiment.synthesis.waveforms import Basis, Stimulus
from tests.approved import Refuses
from tests.experiment.synthesis import stimuli as made

pytestmark = pytest.mark.clocked

RIG = ActuatorRig(driver="pcm-tcp", address="rehearsal", rate_hz=5000, full_scale_m_s2=64.0)


@pytest.fixture(scope="module")
def panel() -> Iterator[Panel]:
    opened = Panel(RIG)
    yield opened
    opened.close()


def actuator(address: str, limit_m_s2: float = 20.0) -> PcmActuator:
    condition = Conditioner(full_scale=RIG.full_scale, limit_m_s2=limit_m_s2)
    return PcmActuator(address, condition, rate_hz=RIG.rate_hz)


def play(opened: Actuator, asked: np.ndarray | Stimulus) -> Played:
    """A foot lands, and the stimulus sounds, which may be any waveform."""
    played = opened.prepare(asked if isinstance(asked, Stimulus) else made.given(asked))
    opened.landed(0)
    return played


def test_what_is_played_is_felt(panel: Panel) -> None:
    wanted = np.random.default_rng(0).normal(0, 4, 2500)
    played = play(actuator(panel.address), wanted)
    felt = panel.felt(0)
    assert felt is not None
    # float32 carries 24 bits.
    assert np.allclose(felt, wanted, rtol=2**-23, atol=0)
    assert (played.samples.size, played.limited) == (2500, 0)
    assert played.on_record().handed_peak == np.max(np.abs(felt))


@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    wanted=arrays.arrays(np.float64, st.integers(1, 40), elements=st.floats(allow_nan=True, allow_infinity=True)),
    limit_m_s2=st.floats(1e-3, 100.0),
)
def test_nothing_above_the_limit_is_felt_whatever_was_asked_for(
    panel: Panel, wanted: np.ndarray, limit_m_s2: float
) -> None:
    played = play(actuator(panel.address, limit_m_s2), wanted)
    felt = panel.felt(0)
    assert felt is not None
    assert felt.size == wanted.size
    assert np.max(np.abs(felt)) <= min(limit_m_s2, RIG.full_scale)
    assert played.on_record().handed_peak == np.max(np.abs(felt))
    assert played.limited == np.count_nonzero(~(np.abs(wanted) <= min(limit_m_s2, RIG.full_scale)))


def test_nothing_sounds_before_the_foot_has_landed_and_nothing_after_it_was_withdrawn(panel: Panel) -> None:
    opened = actuator(panel.address)
    opened.prepare(made.given(np.ones(3)))
    assert opened.aim(10**18)
    assert panel.felt(0) is None
    assert opened.withdraw()
    opened.landed(10**18)
    assert panel.felt(0) is None
    heard = opened.delivered(10**18)
    assert heard is not None
    assert not heard.delivered
    opened.prepare(made.given(np.ones(3)))
    opened.prepare(made.given(np.full(3, 2.0)))
    opened.landed(10**18)
    opened.landed(10**18)
    felt = panel.felt(0)
    assert felt is not None
    assert felt.tolist() == [2.0] * 3
    assert panel.felt(0) is None
    assert opened.delivered(0) is None


def test_stimuli_are_felt_one_by_one_in_order(panel: Panel) -> None:
    for value in (1.0, 2.0, 3.0):
        play(actuator(panel.address), np.full(4, value))
    felt = [panel.felt(0) for _ in range(4)]
    assert [None if one is None else one.tolist() for one in felt] == [[1.0] * 4, [2.0] * 4, [3.0] * 4, None]


def test_a_stimulus_whose_connection_broke_was_not_delivered(panel: Panel) -> None:
    host, port = panel.address.split(":")
    broken = socket.create_connection((host, int(port)))
    broken.sendall(b"\0" * 4000)
    broken.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    broken.close()
    play(actuator(panel.address), np.ones(3))
    felt = panel.felt(0)
    assert felt is not None
    assert felt.tolist() == [1.0] * 3
    assert panel.felt(0) is None


def test_it_is_opened_from_a_rig(repository_root: Path) -> None:
    rig = rigs.load(repository_root / "protocols" / "rigs" / "rehearsal.toml")
    panel = Panel(rig.actuator)
    drive = open_drive(repository_root / "protocols" / "rigs", rig.actuator, limit_m_s2=2.0)
    opened = opening.open_actuator(rig, limit_m_s2=2.0, drive=drive, address=panel.address)
    assert opened.rate_hz == rig.actuator.rate_hz
    # 100 Hz; the second is twice the limit, and taken down as a whole.
    cosine = np.cos(2 * np.pi * 100 * (np.arange(2500) + 0.5) / opened.rate_hz)
    one = np.zeros(101)
    one[100] = 1.0
    for level_m_s2, within_m_s2 in ((1.0, 1.0), (4.0, 2.0)):
        played = play(opened, made.of_bins(level_m_s2 * one, samples=2500, rate_hz=rig.actuator.rate_hz))
        felt = panel.felt(0)
        assert felt is not None
        assert felt == pytest.approx(within_m_s2 * cosine, abs=2e-2 * within_m_s2)
        assert np.abs(felt).max() <= 1.01 * within_m_s2
        assert played.limited == 0
    opened.close()
    panel.close()


SHAPED = ActuatorRig(
    driver="pcm-tcp",
    address="rehearsal",
    rate_hz=5000,
    shaping=ShapingRig(
        response="rehearsal-response.csv",
        response_sha256=hashlib.sha256(shipped("rigs/rehearsal-response.csv").read_bytes()).hexdigest(),
        full_scale_v=10.0,
        gain_limit_v_per_m_s2=4.0,
    ),
)


@pytest.fixture(scope="module")
def materials(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Basis]:
    """The simulated materials, which stand as far apart as Table 3 says, at the rate of `SHAPED`."""
    protocol = files.load(shipped("okamoto2012.toml"))
    recordings = tmp_path_factory.mktemp("recordings") / "simulated"
    recorded_takes.make_recordings(recordings, protocol=protocol, seed=1)
    planned = scene.plan(protocol=protocol, task_id="virtual")
    return preparation.open_stimuli(
        scene=planned, protocol=protocol, recordings=recordings, output_rate_hz=SHAPED.rate_hz
    )


DELIVERED_WITHIN = 3e-3
"""Of the sum of amplitudes from 10 to 500 Hz: asked minus delivered; the errors of straight lines in the table."""


@pytest.mark.parametrize("speed_mm_s", [55.0, 100.0, 180.0, 250.0, 390.0])
@pytest.mark.parametrize("material", ["copy paper", "aluminum foil", "polypropylene", "typing paper"])
def test_what_the_panel_delivers_through_its_response_is_what_was_asked(
    materials: dict[str, Basis], material: str, speed_mm_s: float
) -> None:
    wanted = materials[material].at(speed_mm_s).waveform_m_s2
    panel = Panel(SHAPED)
    drive = open_drive(shipped("rigs/rehearsal-response.csv").parent, SHAPED, limit_m_s2=100.0)
    condition = Conditioner(full_scale=SHAPED.full_scale, limit_m_s2=30.0, drive=drive)
    opened = PcmActuator(panel.address, condition, rate_hz=SHAPED.rate_hz)
    played = play(opened, materials[material].at(speed_mm_s))
    felt = panel.felt(0)
    panel.close()
    assert felt is not None
    frequencies_hz = bin_frequencies_hz(bins=wanted.size, rate_hz=SHAPED.rate_hz)
    asked, delivered = spectrum(wanted), spectrum(felt)
    tactile = (frequencies_hz >= 10) & (frequencies_hz <= 500)
    off = np.abs(delivered - asked)[tactile].sum() / np.abs(asked)[tactile].sum()
    assert off < DELIVERED_WITHIN
    record = played.on_record()
    assert record.limited == 0
    assert 0 < record.handed_peak <= SHAPED.full_scale
    lost = record.shaping
    assert lost is not None
    assert (lost.saturated_bins, lost.bounded_bins) == (0, 0)
    beyond = (frequencies_hz < 10) | (frequencies_hz > 600)
    assert lost.outside_cost_m_s2 == pytest.approx(np.abs(asked)[beyond].sum(), rel=1e-9)
    # Without shaping, volts in the place of accelerations would miss by far.
    unshaped = spectrum(response.moved(wanted / gain_at_100_hz(), rate_hz=SHAPED.rate_hz))
    assert np.abs(unshaped - asked)[tactile].sum() / np.abs(asked)[tactile].sum() > 50 * off


def gain_at_100_hz() -> float:
    return float(response.gain(np.array([100.0]))[0])


def test_nobody_listening_is_an_error_with_a_remedy(refuses: Refuses) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
    with refuses(ActuatorError):
        play(actuator(address), np.ones(3))


Serve = Callable[[Callable[[socket.socket], None]], str]


@pytest.fixture
def serve() -> Iterator[Serve]:
    """A server that treats one connection as it is told."""
    opened: list[tuple[socket.socket, threading.Thread]] = []

    def begun(treat: Callable[[socket.socket], None]) -> str:
        server = socket.create_server(("127.0.0.1", 0))

        def run() -> None:
            connection, _ = server.accept()
            with connection:
                treat(connection)

        thread = threading.Thread(target=run)
        thread.start()
        opened.append((server, thread))
        return f"127.0.0.1:{server.getsockname()[1]}"

    yield begun
    for server, thread in opened:
        thread.join()
        server.close()


def test_a_server_that_breaks_off_is_an_error_with_a_remedy(serve: Serve) -> None:
    def breaks_off(connection: socket.socket) -> None:
        connection.recv(16)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")

    with pytest.raises(ActuatorError, match=r"the connection broke \(.*\); check that its server is running"):
        play(actuator(serve(breaks_off)), np.ones(10**6))


def test_a_server_that_never_ends_is_an_error_with_a_remedy(
    serve: Serve, monkeypatch: pytest.MonkeyPatch, refuses: Refuses
) -> None:
    monkeypatch.setattr(pcm_ports, "CLOSE_S", 0.05)
    over = threading.Event()

    def hangs(_connection: socket.socket) -> None:
        over.wait()

    opened = actuator(serve(hangs))
    with refuses(ActuatorError):
        play(opened, np.ones(100))
    over.set()
    opened.close()


@pytest.mark.parametrize("address", ["", "here", "127.0.0.1:", ":4711", "127.0.0.1:0", "127.0.0.1:99999", "a:b"])
def test_what_is_no_address_is_refused(address: str, refuses: Refuses) -> None:
    with refuses(ActuatorError):
        actuator(address)


@pytest.mark.parametrize("limit_m_s2", [np.nan, np.inf, -1.0])
def test_what_is_no_limit_is_refused_before_anything_is_played(limit_m_s2: float) -> None:
    with pytest.raises(ActuatorError, match="allowed: a finite number"):
        actuator("127.0.0.1:4711", limit_m_s2)


@pytest.mark.parametrize("wanted", [np.empty(0), np.ones((2, 3)), np.float64(1.0)])
def test_what_is_no_stimulus_is_refused(wanted: np.ndarray, refuses: Refuses) -> None:
    with refuses(ActuatorError):
        play(actuator("127.0.0.1:4711"), wanted)


def test_pulseaudio_plays_every_sample(pulseaudio: tuple[str, dict[str, str]]) -> None:
    address, environment = pulseaudio
    rng = np.random.default_rng(1)
    wanted = rng.uniform(-30, 30, 9600)
    wanted[[0, -1]] = 25.0
    with subprocess.Popen(
        ["parec", "--device=rig.monitor", "--raw", "--format=float32le", "--rate=48000", "--channels=1"],
        env=environment,
        stdout=subprocess.PIPE,
    ) as recorder:
        assert recorder.stdout is not None
        recorded = recorder.stdout.read(4)
        played = play(PcmActuator(address, Conditioner(full_scale=64.0, limit_m_s2=16.0), rate_hz=48_000), wanted)
        heard = np.zeros(0, dtype="<f4")
        # The watchdog ends a recorder that would never hear the stimulus.
        watchdog = threading.Timer(20.0, recorder.kill)
        watchdog.start()
        while np.count_nonzero(heard) < 9600 and (piece := recorder.stdout.read(19_200)):
            recorded += piece
            heard = np.frombuffer(recorded, "<f4")
        watchdog.cancel()
        recorder.kill()
    begin = int(np.flatnonzero(heard)[0])
    assert np.array_equal(heard[begin : begin + 9600], (np.clip(wanted, -16, 16) / 64).astype(np.float32))
    assert np.count_nonzero(heard) == 9600
    assert played.limited == np.count_nonzero(np.abs(wanted) > 16)


def test_pulseaudio_closes_before_it_has_played_and_the_doctor_sees_it(
    pulseaudio: tuple[str, dict[str, str]],
) -> None:
    found = {one.check: one.verdict for one in checks.server(pulseaudio[0], RIG.model_copy(update={"rate_hz": 48_000}))}
    assert found == {
        "actuator": "passes",
        "actuator samples": "refuses",
        "actuator turns": "refuses",
        "actuator stop": "passes",
    }


@pytest.mark.parametrize("frequency_hz", [60.0, 210.0, 250.0, 300.0, 360.0])
@pytest.mark.parametrize("limit_m_s2", [2.0, 10.0, 20.0])
def test_what_a_rig_in_volts_delivers_stays_within_the_limit_of_vibration(
    frequency_hz: float, limit_m_s2: float
) -> None:
    # It is three times too strong, and taken down as a whole.
    panel = Panel(SHAPED)
    rig = rigs.load(shipped("rigs/rehearsal.toml"))
    drive = open_drive(shipped("rigs/rehearsal-response.csv").parent, SHAPED, limit_m_s2=limit_m_s2)
    opened = opening.open_actuator(
        rig.model_copy(update={"actuator": SHAPED}), limit_m_s2=limit_m_s2, drive=drive, address=panel.address
    )
    # One bin is one hertz.
    asked = np.zeros(int(frequency_hz) + 1)
    asked[-1] = 3 * limit_m_s2
    played = play(opened, made.of_bins(asked, samples=2500, rate_hz=SHAPED.rate_hz))
    felt = panel.felt(1.0)
    panel.close()
    assert felt is not None
    # The table and the closed form of the simulated panel differ by less than one percent. How much less is felt where
    # the rig cannot reach the limit is the rig's affair; it is not silent.
    assert 0.3 * limit_m_s2 < np.abs(felt).max() <= 1.01 * limit_m_s2
    assert played.limited == 0
