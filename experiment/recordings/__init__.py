"""Recordings on disk: one WAV a take with a manifest, and the files that other software writes."""
