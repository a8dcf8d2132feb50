"""REHEARSAL: the sound of one session, on a simulated sound card of its own."""

from __future__ import annotations

from contextlib import ExitStack
from types import TracebackType

from experiment.apparatus import opening_audio
from experiment.apparatus.rig import Rig
from experiment.clock import Clock
from experiment.protocol.models import Protocol
from experiment.rehearsal.card_panel import LONGEST_S, CardPanel
from experiment.rehearsal.sound_card import DEVICE, SoundCard
from experiment.session.sound import open_sound


class SimulatedSound:
    """The card, the session's stream on it and its masker; all until it is left.

    The card is wired as a rig is: the actuator's channel goes back into the loopback, and to the panel where a task has
    one.
    """

    def __init__(self, rig: Rig, protocol: Protocol, clock: Clock, *, dose_before: float = 0.0) -> None:
        """Start everything.

        Args:
            rig: a simulated rig with an audio device.
            protocol: the study.
            clock: the session's clock; it must go by itself.
            dose_before: of the masker, what the participant's sessions of the day used up.

        Raises:
            AudioError: JACK is not installed, or does not run.
        """
        audio = opening_audio.audio_of(rig)
        channels = audio.channels
        with ExitStack() as opened:
            self.card = SoundCard(
                rate_hz=audio.rate_hz, block=audio.block, inputs=channels.inputs, outputs=channels.outputs
            )
            opened.callback(self.card.close)
            sound = open_sound(rig, protocol, clock=clock, dose_before=dose_before, opened=opened, device=DEVICE)
            self.stream, self.masker = sound.stream, sound.masker
            for entry in range(1, channels.inputs + 1):
                self.card.disconnect(entry)
            self._channels = channels
            self.connect_loopback()
            self._actuator = rig.actuator
            self._opened = opened.pop_all()

    def panel(self) -> CardPanel:
        """The panel on the actuator's channel, from now on. Raises `AudioError`."""
        panel = CardPanel(self.card.tap(self._channels.actuator, seconds=LONGEST_S), self._actuator)
        self._opened.callback(panel.close)
        return panel

    def connect_loopback(self) -> None:
        """Lay the loopback's cable, where the rig has one."""
        if self._channels.loopback is not None:
            self.card.connect(self._channels.actuator, self._channels.loopback)

    def disconnect_loopback(self) -> None:
        """Pull it: for tests of what a rig does then; no rehearsal pulls it."""
        if self._channels.loopback is not None:
            self.card.disconnect(self._channels.loopback)

    def __enter__(self) -> SimulatedSound:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()
