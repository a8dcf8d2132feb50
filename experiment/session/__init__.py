"""One session: one participant who does one task.

`run` holds the gates of a real session and `runner` its trials, `attempt` by `attempt`; `laboratory` opens everything
that the task needs, as `scene` decides, and `masker` the sound. `kind` is the seam to a kind of trial, of which
`footstep/` is one. A protocol, a rig and a participant come in; a journal with its file of raw frames goes out. This
room does not know whether the far ends of its ports are simulated.
"""
