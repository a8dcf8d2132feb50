"""Words that sessions and recordings put to the experimenter alike."""

RESTS = (
    "Zeroing: the foot rests on the bare panel, still. Press Enter when it does, or Ctrl-C to pause; the same command "
    "goes on: "
)
