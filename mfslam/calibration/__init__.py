"""Self-calibration: wheels, mount, delay, clock, gyro and the laser's turn, from the motions of an ordinary log.

The equations and what can be seen of which parameter: docs/calibration.md.
"""
