"""Boards that count wheel encoders.

`protocol`: lines with a checksum, by their own clock (docs/sensors.md); no I/O. `streaming`: a board that
sends them. `arduino`: the firmware of ros_arduino_bridge, which tells its counters when asked.
"""
