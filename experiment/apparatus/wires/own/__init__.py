"""Devices by one file: a lab's own driver of an actuator, an accelerometer or a force device.

Each runs in a process of its own (`hosting` starts it, `process` is it), so that a driver that raises, hangs or crashes
costs no session more than its device. `loading` is shared with trackers and triggers, whose drivers run here.
"""
