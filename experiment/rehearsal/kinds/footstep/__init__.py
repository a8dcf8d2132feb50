"""SIMULATED footsteps: the materials, their recording, and the participant who steps and answers.

Participants feel what the panel received; nothing else tells them the material. No number here was measured on a real
object or a person.
"""
