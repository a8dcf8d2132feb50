"""Where the foot is: from bytes on a serial line to a height, a speed through the gate, and a contact.

Frames come in (`serial_port`, `serial_tracker`, `frames`), or whatever a laboratory's own driver reads (`guarded`);
samples go out, with a map from the device's clock to the session's (`clock_map`). `gate` finds passages and contacts,
`landing` predicts them, `calibration` says what a reading is in mm. This room knows no stimulus.
"""
