"""2D laser SLAM for wheeled robots in which no scan is a snapshot: every beam has its own instant."""

__version__ = "0.1.0"
