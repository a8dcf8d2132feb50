"""One full-duplex audio stream: masker, stimulus, microphone and loopback on one sample clock."""
