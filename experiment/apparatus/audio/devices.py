"""The audio devices of this machine, by host API and name; what PortAudio says against one becomes an `AudioError`."""

from __future__ import annotations

import atexit
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from experiment.errors import AudioError

CLOSE_S = 5.0
"""How long a device may take to close, s."""

_left_alone = False
"""Whether PortAudio still waits for a stream that was to be closed."""

_REMEDIES = (
    ("unavailable", "another program holds it, or it was pulled out; close that program, then start again"),
    ("sample rate", "it does not run at {rate_hz} Hz; set the device to it, or correct audio.rate_hz in the rig file"),
    ("channels", "it has fewer channels; correct audio.channels in the rig file"),
)
"""What PortAudio's message holds, and what that means to an experimenter."""


@dataclass(frozen=True)
class Device:
    """A device as PortAudio names it."""

    host_api: str
    name: str
    inputs: int
    outputs: int
    rate_hz: float


def library() -> Any:
    """Return the module `sounddevice`; `AudioError` if it, or the PortAudio that it needs, is not installed."""
    try:
        import sounddevice
    except (ImportError, OSError) as error:
        raise AudioError(
            f"audio: sounddevice cannot be used ({error}); install palpate[lab], and PortAudio "
            "(the system's package libportaudio2)"
        ) from error
    return sounddevice


def close(stream: Any) -> None:
    """Close a stream of this process.

    PortAudio waits for ten minutes to close one whose JACK server has gone, and would do so again as the process ends.
    So a stream that has stopped by itself is left alone after `CLOSE_S`, for good.
    """
    global _left_alone
    if stream.active:
        stream.close()
        return
    failed: list[Exception] = []

    def closing() -> None:
        try:
            stream.close()
        except Exception as error:
            failed.append(error)

    thread = threading.Thread(target=closing, name="closing", daemon=True)
    thread.start()
    thread.join(CLOSE_S)
    if thread.is_alive():
        _left_alone = True
        atexit.unregister(library()._exit_handler)
    elif failed:
        raise failed[0]


@contextmanager
def looking_anew() -> Iterator[None]:
    """Have PortAudio look for devices again afterwards; by itself it looks once. No stream may be open in this process.

    An audio server is started or stopped inside: PortAudio must have left a server that goes.
    """
    if _left_alone:
        yield
        return
    sounddevice = library()
    sounddevice._terminate()
    try:
        yield
    finally:
        sounddevice._initialize()


def devices() -> tuple[Device, ...]:
    """Return every device of every host API."""
    sounddevice = library()
    apis = [api["name"] for api in sounddevice.query_hostapis()]
    return tuple(
        Device(
            host_api=apis[each["hostapi"]],
            name=each["name"],
            inputs=each["max_input_channels"],
            outputs=each["max_output_channels"],
            rate_hz=each["default_samplerate"],
        )
        for each in sounddevice.query_devices()
    )


def find(*, host_api: str, name: str, inputs: int, outputs: int) -> int:
    """Return PortAudio's number of a device that has so many inputs and outputs at least.

    The host API is as PortAudio names it, such as `JACK Audio Connection Kit`.

    Raises:
        AudioError: there is no device of this name, or it has fewer channels.
    """
    present = devices()
    named = [(i, each) for i, each in enumerate(present) if (each.host_api, each.name) == (host_api, name)]
    if not named:
        there = "; ".join(sorted({f"{each.host_api}: {each.name}" for each in present})) or "none"
        raise AudioError(
            f"audio device '{name}' of {host_api}: got no device of this name; allowed: {there}; plug it in, start its "
            "server, or close the program that holds it, or correct [audio] in the rig file"
        )
    for i, each in named:
        if each.inputs >= inputs and each.outputs >= outputs:
            return i
    widest = max(named, key=lambda pair: (pair[1].outputs, pair[1].inputs))[1]
    raise AudioError(
        f"audio device '{name}' of {host_api}: got {widest.outputs} outputs and {widest.inputs} inputs; allowed: at "
        f"least {outputs} and {inputs}, as audio.channels in the rig file has it; close the program that holds it, for "
        "a device that is held shows fewer, or correct audio.channels, or choose another device"
    )


@contextmanager
def explained(name: str, *, rate_hz: int) -> Iterator[None]:
    """Turn an error of PortAudio into one that an experimenter understands; the device was asked for `rate_hz`."""
    sounddevice = library()
    try:
        yield
    except (sounddevice.PortAudioError, ValueError) as error:
        said = str(error)
        remedy = next((text for sign, text in _REMEDIES if sign in said.lower()), "see to the device and its server")
        raise AudioError(f"audio device '{name}': {said}: {remedy.format(rate_hz=rate_hz)}") from error
