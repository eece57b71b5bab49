"""Compiled inner loops: arrays in, arrays out, no classes, no checks (their callers check).

Poses are (x, y, theta) scalars or arrays; every kernel releases the GIL and is cached on disk, so the
compilation is paid once per installation.
"""
