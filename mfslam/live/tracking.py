"""Where the robot is, as soon as a scan has come: the front end alone, in a frame that never jumps."""

from __future__ import annotations

from dataclasses import dataclass

from mfslam.config import Config
from mfslam.frontend import Frontend
from mfslam.kernels import poses
from mfslam.motion import MotionSources
from mfslam.ranges import with_true_ranges
from mfslam.step_records import GOOD_FIT, Keyframe, Step
from mfslam.types import Findings, FloatArray, Message, Scan


@dataclass(frozen=True, eq=False)
class Tracked:
    """A scan where it was placed when it came."""

    number: int
    scan: Scan
    step: Step
    twist: FloatArray


class Tracker:
    """Places every scan at once, with what wheels and gyro have told until then.

    The engine of `mfslam.slam` waits for the next scan, by which the wheels have told the motion through this one;
    nobody who steers by the pose can. What that costs, the back end makes good.
    """

    def __init__(self, config: Config) -> None:
        self.findings = Findings()
        self.frontend = Frontend(config)
        self._sensor = config.sensor
        self._motion = MotionSources(config, self.findings)
        self._before: tuple[int, Keyframe] | None = None  # the latest keyframe, and its number among all
        self.keyframes = self._placed = 0

    def note(self, message: Message) -> None:
        """Wheels, gyro, compass."""
        self._motion.add(message)

    def place(self, number: int, scan: Scan) -> Tracked:
        """Place a scan; ``number``: of all that came, those that were not placed included."""
        index, self._placed = self._placed, self._placed + 1  # as `MotionSources` counts
        scan = with_true_ranges(scan, self._sensor)
        self._motion.add(scan)
        motion = self._motion.predict(scan, self.frontend.local_T_body, self.frontend.last_step)
        step = self.frontend.process(index, scan, motion)
        if step.odometry_jump:
            self._motion.jumps.append(index)
        if step.is_keyframe:
            self._learn(step)
        return Tracked(number, scan, step, motion.twist if step.twist is None else step.twist[:3])

    def _learn(self, step: Step) -> None:
        """What a step between keyframes teaches of the errors of wheels and gyro."""
        keyframe = self.frontend.recent[-1]
        if self._before is not None and step.blind_s == 0.0 and step.match is not None:
            number, before = self._before
            moved = poses.between(before.local_T_body, keyframe.local_T_body)
            sure = step.match.inlier_ratio > GOOD_FIT
            for _ in self._motion.edges(
                number,
                number + 1,
                before.scan_index,
                keyframe.scan_index,
                moved,
                step.match.information,
                sure,
            ):
                continue
        self._before = (self.keyframes, keyframe)
        self.keyframes += 1
