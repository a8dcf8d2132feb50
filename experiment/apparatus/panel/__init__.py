"""What shakes the panel, and what hears it.

In comes a `synthesis.waveforms.Stimulus`; out go limited samples to a device, and what goes on record of them.
`conditioning` takes a stimulus to the samples of a device, by the rig's response table (`response_table`) where it
takes volts; the limiter stands there, last before the device. `pcm` hands them to a server of raw
samples, and listens to another; an actuator on a channel of the session's stream stands in `apparatus.audio`.

No session, protocol or participant is known here.
"""
