"""Pose graphs as data: what a file tells, what poses leave of its edges, how low chi2 can be at all."""
