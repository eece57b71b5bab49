"""Mapping while the robot drives: the pose at once, graph, loops and map beside it in processes of their own.

`engine` (`LiveSlam`) is what a program holds; `tracking` places every scan as it comes; `back_end` is the process
that maps, with the engine of `mfslam.slam`; `state` is what a viewer sees.
"""
