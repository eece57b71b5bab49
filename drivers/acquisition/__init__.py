"""Live sensors into messages, a recording, and a feed for whoever maps: in a process of its own, without gtsam.

`sources`: what ``--lidar`` and ``--wheels`` name. `pump`: sensors, each in its thread, into one stream and the
recording. `feed`: the same in a process of its own, as a `drivers.base.Feed`. `messages`: how they go there.
"""
