"""Recordings of materials on disk: made on a rig (`workflow`), saved (`store`) and read for synthesis (`manifest`)."""
