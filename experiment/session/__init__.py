"""One session: one participant who does one task.

`run` checks what a real session needs and `runner` runs its trials, `attempt` by `attempt`; `laboratory` opens what
`scene` decides, and `masker` the sound. `kind` is the seam to a kind of trial, such as `kinds/footstep/`.
"""
