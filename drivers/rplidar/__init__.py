"""Slamtec RPLIDAR A1 to A3, S1 to S3 and C1 over their serial protocol, standard scan.

`protocol`: requests and answers, bytes into points, no I/O. `sensor`: a `drivers.base.Sensor`.
"""
