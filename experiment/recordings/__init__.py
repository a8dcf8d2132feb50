"""Recordings of materials, on disk.

Steps on a rig come in through a tracker and an accelerometer (`workflow`), and go out as takes with a manifest
(`store`), from which spectra are made (`manifest`). A folder of recordings is complete or absent. `readers` reads a
recording from anywhere, and `spectrum` shows its spectrum. This room knows neither sessions nor answers.
"""
