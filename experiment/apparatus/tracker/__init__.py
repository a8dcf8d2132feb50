"""Where the foot is: from bytes on a serial line to a height, a speed through the gate, and a contact.

Frames come in (`serial_port`, `serial_tracker`, `frames`, `guarded`), and are dated (`clock_map`). `gate` finds
passages and contacts, `landing` predicts them, `calibration` gives mm.
"""
