"""SIMULATED footsteps: the foot, the panel, the materials, and the participant who steps and answers.

The far ends of tracker, actuator and accelerometer are here, with what is true of each step, which no session is told.
What a participant feels is what the panel received; nothing else tells it which material was meant. No number here was
measured on a real object or a person. This room knows neither journals nor datasets.
"""
