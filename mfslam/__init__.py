"""2D laser SLAM for wheeled robots in which no scan is a snapshot."""
