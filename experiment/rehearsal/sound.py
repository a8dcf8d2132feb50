"""REHEARSAL: the sound of one session, on a simulated sound card of its own."""

from __future__ import annotations

from contextlib import ExitStack
from datetime import UTC, datetime
from types import TracebackType

from experiment import scene
from experiment.apparatus import opening
from experiment.apparatus.audio.masker import ROUND_S
from experiment.apparatus.rig import Rig
from experiment.clock import Clock
from experiment.protocol.models import Protocol
from experiment.rehearsal.card_panel import LONGEST_S, CardPanel
from experiment.rehearsal.sound_card import DEVICE, SoundCard


class Sound:
    """The card, the session's stream on it, its masker, and the panel on the actuator's channel; all until it is left.

    The card is wired as a rig is: the actuator's channel goes to the panel, and back into the loopback.
    """

    def __init__(self, rig: Rig, protocol: Protocol, clock: Clock) -> None:
        """Start everything.

        Args:
            rig: a simulated rig with an audio device.
            protocol: the study.
            clock: the session's clock; it must go by itself.

        Raises:
            AudioError: JACK is not installed, or does not run.
        """
        audio = opening.audio_of(rig)
        channels = audio.channels
        with ExitStack() as opened:
            self.card = SoundCard(
                rate_hz=audio.rate_hz, block=audio.block, inputs=channels.inputs, outputs=channels.outputs
            )
            opened.callback(self.card.close)
            samples = scene.masker_samples(protocol=protocol, rate_hz=audio.rate_hz, seconds=ROUND_S)
            noise = opening.masker_noise(rig, samples=samples, limit_db_a=protocol.exposure.masker_level_db_a)
            self.stream = opening.open_audio(
                rig,
                limit_m_s2=protocol.exposure.vibration_peak_m_s2,
                masker=noise,
                clock=clock,
                today=datetime.fromtimestamp(clock.now_ns() / 1e9, tz=UTC).date(),
                device=DEVICE,
            )
            opened.callback(self.stream.close)
            self.masker = opening.open_masker(rig, stream=self.stream, noise=noise, clock=clock)
            for entry in range(1, channels.inputs + 1):
                self.card.disconnect(entry)
            self.loopback = channels.loopback
            if self.loopback is not None:
                self.card.connect(channels.actuator, self.loopback)
            self.panel = CardPanel(self.card.tap(channels.actuator, seconds=LONGEST_S), rig.actuator)
            opened.callback(self.panel.close)
            self._opened = opened.pop_all()

    def disconnect_loopback(self) -> None:
        """Pull the loopback's cable."""
        if self.loopback is not None:
            self.card.disconnect(self.loopback)

    def __enter__(self) -> Sound:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()
