"""Windows of the laser's motion against the wheels' track: errors and how they depend on what is sought."""

from __future__ import annotations

import numpy as np

from mfslam import se2
from mfslam.calibration.record import Record, without
from mfslam.calibration.wheel_track import WheelLaw, WheelTrack
from mfslam.types import FloatArray, IntArray

MOUNT = ("mount_x_m", "mount_y_m", "mount_yaw_rad")
CLOCK = ("delay_s", "clock_drift")
CLOCK_PRIOR = np.array([0.5, 1e-3])
MOUNT_PRIOR = np.array([1.0, 1.0, 1.0])
SMALL, SHIFT_S = 1e-6, 0.05
LEAST_POWER = 5.0  # of motions over that of the noise


class Problem:
    """e = log(a_T_b^-1 mount^-1 W(t_a, t_b) mount) of every window, W the wheels' motion.

    How e depends on wheels and mount is taken at the motion that the laser saw, not at the one that the wheels told:
    noise of the ticks in both, e and its derivative, would make wheels seem to turn less than they do.
    """

    def __init__(
        self, record: Record, law: WheelLaw, clock: bool = True, delay_s: float = 0.0, length: float = 1.0
    ) -> None:
        """``length``: of the windows, times as long as usual."""
        self.record, self.law = record, law
        self.track = WheelTrack(record.knots_s, record.told_steps, law)
        windows = record.windows(length)
        reach_s = 2.0 * SHIFT_S if clock else 0.0
        ta, tb = record.times_s[windows.a] + delay_s, record.times_s[windows.b] + delay_s
        self.windows = without(windows, ~self.track.unbroken(ta - reach_s, tb + reach_s))
        self.clock = clock
        self.names = (*law.names, *MOUNT, *(CLOCK if clock else ()))
        self.start = np.concatenate([law.start, record.laser.body_T_laser, np.zeros(2 if clock else 0)])
        self.prior_sigmas = np.concatenate(
            [law.prior_sigmas, MOUNT_PRIOR, CLOCK_PRIOR if clock else np.zeros(0)]
        )
        self.middle_s = 0.5 * float(record.times_s[0] + record.times_s[-1])
        self.n_wheel = len(law.names)

    @property
    def geometry(self) -> int:
        """How many of the values are of wheels and mount: the clock's come last."""
        return self.n_wheel + len(MOUNT)

    def times(self, values: FloatArray, index: IntArray) -> FloatArray:
        """Instants of scans on the wheels' clock."""
        times = self.record.times_s[index]
        if not self.clock:
            return np.asarray(times)
        delay, drift = values[-2:]
        return np.asarray(times + delay - drift * (times - self.middle_s))

    def body_motion(self, values: FloatArray, a: IntArray, b: IntArray) -> FloatArray:
        return se2.between(self.track.at(self.times(values, a)), self.track.at(self.times(values, b)))

    def error(self, values: FloatArray, body: FloatArray, a_T_b: FloatArray) -> FloatArray:
        mount = self._mount(values)
        predicted = se2.compose(se2.compose(se2.inverse(mount), body), mount)
        return se2.log(se2.between(a_T_b, predicted))

    def errors(self, values: FloatArray, a: IntArray, b: IntArray, a_T_b: FloatArray) -> FloatArray:
        self.track.move(values[: self.n_wheel])
        return self.error(values, self.body_motion(values, a, b), a_T_b)

    def linearised(self, values: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Errors (N, 3) and their derivatives (N, 3, P). ``ends`` (3,): variances of the laser's poses; motions that they
        could feign count as none."""
        w = self.windows
        out = np.empty((len(w), 3, len(values)))
        error = self.errors(values, w.a, w.b, w.a_T_b)
        mount = self._mount(values)
        twists = se2.log(se2.compose(se2.compose(mount, w.a_T_b), se2.inverse(mount)))  # as the laser saw it
        twists = twists * (np.mean(twists**2, axis=0) > LEAST_POWER * 2.0 * ends)
        told, seen = self.law.told_twists(twists, values[: self.n_wheel]), se2.exp(twists)
        at_rest = self.error(values, seen, w.a_T_b)
        for p in range(self.n_wheel + 3):
            step = values.copy()
            step[p] += SMALL
            moved = seen if p >= self.n_wheel else se2.exp(self.law.true_twists(told, step[: self.n_wheel]))
            out[:, :, p] = (self.error(step, moved, w.a_T_b) - at_rest) / SMALL
        if self.clock:
            # over a while: a step of one tick is noise, and the error at that end of the window holds the same noise
            later, earlier = values.copy(), values.copy()
            later[-2] += SHIFT_S
            earlier[-2] -= SHIFT_S
            moved_on, not_yet = (
                self.error(values, self.body_motion(v, w.a, w.b), w.a_T_b) for v in (later, earlier)
            )
            out[:, :, -2] = (moved_on - not_yet) / (2.0 * SHIFT_S)
            since_s = 0.5 * (self.record.times_s[w.a] + self.record.times_s[w.b]) - self.middle_s
            out[:, :, -1] = -since_s[:, None] * out[:, :, -2]
        return error, out

    def _mount(self, values: FloatArray) -> FloatArray:
        return values[self.n_wheel : self.n_wheel + 3]
