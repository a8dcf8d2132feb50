"""REHEARSAL: the simulated sound card, a JACK server of palpate's own with its dummy driver. It plays to nobody.

`connect` is a cable from an output to an input, `Tap` listens to an output, `WiredCard` has a rig's cables.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal

from filelock import FileLock, Timeout

from palpate.experiment.apparatus import host, opening
from palpate.experiment.apparatus.audio.stream import looking_anew
from palpate.experiment.apparatus.rig import Rig
from palpate.experiment.errors import AudioError
from palpate.experiment.rehearsal.wires.listener import Tap
from palpate.experiment.rehearsal.wires.panel import LONGEST_S, CardPanel

if TYPE_CHECKING:
    from palpate.experiment.rehearsal.wires.modes import MovingPanel
    from palpate.experiment.rehearsal.wires.mouth import Mouth, Samples

DEVICE = "system"
"""As PortAudio names the simulated card."""

STREAM = "PortAudio"
"""The client that a session's stream is, as JACK names it."""

SERVER_PRIORITY = 10
"""Of the server's threads where the session runs in real time; JACK gives its clients five less."""

READY_S = 10.0
"""How long the server may take to start, s."""

PLACES = 6
"""Most servers of this kind on a machine (JACK allows eight of any); names are reused, as JACK frees places by name."""

_SERVER = "JACK_DEFAULT_SERVER"
_VARIABLES = {"JACK_NO_AUDIO_RESERVATION": "1", "JACK_NO_START_SERVER": "1"}


class SoundCard:
    """A running JACK server; this process's streams find it, and no other, until it is closed."""

    def __init__(self, *, rate_hz: int, block: int, inputs: int, outputs: int, exact: bool = True) -> None:
        """Start the server and wait for it. No audio stream may be open in this process.

        A period has `block` frames; `inputs` and `outputs` are numbers of channels. If `exact`, a period waits for
        every client, so that no sample is lost. Raises `AudioError` without JACK or a start.
        """
        if sys.platform == "win32":
            raise AudioError(
                "simulated sound card", "got Windows", "use a rig without an audio device", allowed="Linux or macOS"
            )
        program = shutil.which("jackd")
        if program is None:
            raise AudioError(
                "simulated sound card", "got no jackd", "install the system package jackd2", allowed="JACK 2"
            )
        self._jack = _jack()
        self._before = {name: os.environ.get(name) for name in (*_VARIABLES, _SERVER)}
        self.folder = tempfile.TemporaryDirectory(prefix="palpate-jack-")
        self._place: FileLock | None = None
        os.environ.update(_VARIABLES)
        arguments = ["-r", str(rate_hz), "-p", str(block), "-C", str(inputs), "-P", str(outputs)]
        ends = shutil.which("setpriv")
        # The server must not outlive this process, even where that is killed: the kernel ends it with its parent,
        # and -T with its last client.
        command = [*([ends, "--pdeathsig", "KILL"] if ends else []), program, *(["-S"] if exact else []), "-T"]
        pace = ["--realtime", "--realtime-priority", str(SERVER_PRIORITY)] if host.is_real_time() else ["--no-realtime"]
        try:
            with host.elsewhere(), looking_anew():
                self._wiring = self._started([*command, *pace, "-n"], ["-d", "dummy", *arguments])
        except BaseException:
            self._tidy()
            raise

    def connect(self, output: int, *to: int) -> None:
        """Lay a cable from an output of the open stream to some of its inputs, from 1. Raises `AudioError`."""
        for entry in to:
            self._wired(self._wiring.connect, self._port("out", output), self._port("in", entry))

    def disconnect(self, entry: int) -> None:
        """Pull every cable from an input of the session's stream. Raises `AudioError` as `connect`."""
        port = self._port("in", entry)
        for source in self._wired(self._wiring.get_all_connections, port):
            self._wired(self._wiring.disconnect, source, port)

    def tap(self, output: int, *, seconds: float) -> Tap:
        """Listen to an output of the session's stream from now on. Raises `AudioError`, also without a server."""
        with host.elsewhere(), host.taking_turns():
            return Tap(self.name, self._port("out", output).name, seconds=seconds)

    def mouth(self, headphones: int, microphone: int, response: Samples) -> Mouth:
        """Put a mouth before an input of the session's stream; headphones on an output leak. Raises `AudioError`."""
        from palpate.experiment.rehearsal.wires.mouth import Mouth

        with host.elsewhere(), host.taking_turns():
            ports = {"headphones": self._port("out", headphones).name, "microphone": self._port("in", microphone).name}
            return Mouth(self.name, **ports, response=response)

    def close(self) -> None:
        """Stop the server. Streams and taps must be closed before; if interrupted, it ends with this process."""
        try:
            with looking_anew():
                if self.server.poll() is None:
                    self._wiring.close()
                self._stop()
        finally:
            self._tidy()

    def _started(self, before: list[str], after: list[str]) -> Any:
        """Start a server under the first name that is free, and return a client of it."""
        said = f"{PLACES} are already running"
        for number in range(PLACES):
            name = f"palpate-{number}"
            place = FileLock(Path(tempfile.gettempdir()) / f"palpate-jack-{os.getuid()}-{number}.lock", timeout=0)
            try:
                place.acquire()
            except Timeout:
                continue
            log = Path(self.folder.name) / "log"
            with log.open("wb") as file:
                self.server = subprocess.Popen(  # noqa: S603
                    [*before, name, *after], stdout=file, stderr=file, stdin=subprocess.DEVNULL, start_new_session=True
                )
            self.name, os.environ[_SERVER] = name, name
            client = None
            try:
                client = self._client()
            finally:
                if client is None:
                    self._stop()
                    place.release()
            if client is not None:
                self._place = place
                return client
            said = " ".join(log.read_text("utf-8", "replace").strip().splitlines()[-1:])
        raise AudioError(
            "simulated sound card",
            f"JACK did not start ({said})",
            "check that jackd runs on this computer, then start again",
        )

    def _client(self) -> Any:
        """Return a client of the server, to lay cables; None where it has ended or is not ready in time."""
        ends = time.monotonic() + READY_S
        while self.server.poll() is None and time.monotonic() < ends:
            try:
                return self._jack.Client("wiring", servername=self.name, no_start_server=True)
            except self._jack.JackError:
                time.sleep(0.02)
        return None

    def channels(self, kind: Literal["in", "out"]) -> int:
        """Return how many inputs or outputs the session's stream has."""
        return len(self._ports(kind))

    def _ports(self, kind: str) -> list[Any]:
        # PortAudio goes on counting from stream to stream.
        ports = self._wiring.get_ports(f"^{STREAM}:{kind}_[0-9]+$")
        return sorted(ports, key=lambda port: int(port.shortname.rpartition("_")[2]))

    def _port(self, kind: str, channel: int) -> Any:
        ports = self._ports(kind)
        if not 1 <= channel <= len(ports):
            raise AudioError(
                "simulated sound card",
                f"got channel {channel} ({kind})",
                "first open the stream with as many channels as are connected",
                allowed=f"1 to {len(ports)}",
            )
        return ports[channel - 1]

    def _wired(self, call: Callable[..., Any], *ports: Any) -> Any:
        try:
            return call(*ports)
        except self._jack.JackError as error:
            raise AudioError("simulated sound card", error, "start again") from error

    def _stop(self) -> None:
        self.server.terminate()
        try:
            self.server.wait(5)
        except subprocess.TimeoutExpired:
            self.server.kill()
            self.server.wait()

    def _tidy(self) -> None:
        self.folder.cleanup()
        if self._place is not None:
            self._place.release()
        for name, value in self._before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _jack() -> ModuleType:
    try:
        import jack
    except (ImportError, OSError) as error:
        raise AudioError(
            "simulated sound card",
            f"the JACK-Client package does not work ({error})",
            "install palpate[lab] and JACK 2 (system package jackd2)",
        ) from error
    # The library's messages would stand between the experimenter's lines.
    with suppress(AttributeError):
        jack.set_error_function(lambda _text: None)
        jack.set_info_function(lambda _text: None)
    module: ModuleType = jack
    return module


class WiredCard:
    """A sound card wired as a rig: the actuator's channel leads to loopback and panel; leaving it closes both."""

    def __init__(self, rig: Rig) -> None:
        """Start the card of a simulated rig with an audio device. Raises `AudioError` where JACK does not run."""
        audio = opening.audio_of(rig)
        self._rig, self._channels, self._rate_hz = rig, audio.channels, audio.rate_hz
        outputs, inputs = opening.open_channels(rig)
        with ExitStack() as opened:
            self.card = SoundCard(rate_hz=audio.rate_hz, block=audio.block, inputs=inputs, outputs=outputs)
            opened.callback(self.card.close)
            self._opened = opened.pop_all()

    def wire(self) -> None:
        """Lay the rig's open cables once a stream is open; JACK connects a new stream to every input by itself."""
        inputs = self.card.channels("in")
        for entry in range(1, inputs + 1):
            self.card.disconnect(entry)
        self.connect_loopback()

    def panel(self, site: str | None, moving: MovingPanel | None) -> CardPanel:
        """Return the panel on the channel of a site's actuator, from now on. Raises `AudioError`."""
        own = self._rig.at(site)
        tap = self.card.tap(opening.audio_of(own).channels.actuator, seconds=LONGEST_S)
        panel = CardPanel(tap, own.actuator, moving)
        self._opened.callback(panel.close)
        return panel

    def mouth(self) -> Mouth:
        """Return the mouth before the rig's microphone, in a room that is heard from now on. Raises `AudioError`."""
        headphones, microphone = self._channels.headphones[0], self._channels.microphone
        if microphone is None:
            raise AudioError("simulated sound card", "got no audio.channels.microphone", "add it", allowed="an input")
        from palpate.experiment.rehearsal.wires.mouth import leak

        mouth = self.card.mouth(headphones, microphone, leak(rate_hz=self._rate_hz))
        self._opened.callback(mouth.close)
        return mouth

    def connect_loopback(self) -> None:
        """Lay the cable of each loopback that the rig has, and the open stream channels for."""
        outputs, inputs = self.card.channels("out"), self.card.channels("in")
        each = (opening.audio_of(one).channels for one in self._rig.views.values())
        for actuator, loopback in {(one.actuator, one.loopback) for one in each}:
            if loopback is not None and loopback <= inputs and actuator <= outputs:
                self.card.connect(actuator, loopback)

    def __enter__(self) -> WiredCard:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()
