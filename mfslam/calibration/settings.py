"""A calibration as settings: for the next run, and as a file for ``--config``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mfslam.config import Config

if TYPE_CHECKING:
    from mfslam.calibration.outcome import Calibration

Values = dict[str, float | bool | tuple[float, ...]]
Settings = dict[str, Values]
KEYS = {
    "radius_left": ("wheels", "radius_left_m"),
    "radius_right": ("wheels", "radius_right_m"),
    "track": ("wheels", "track_m"),
    "mount_x": ("sensor", "mount_x_m"),
    "mount_y": ("sensor", "mount_y_m"),
    "mount_yaw": ("sensor", "mount_yaw_deg"),
    "delay": ("sensor", "transport_delay_s"),
    "clock_drift": ("sensor", "clock_drift"),
    "turn_period": ("sensor", "turn_period_s"),
    "gyro_scale": ("imu", "gyro_scale"),
    "gyro_bias": ("imu", "gyro_bias_rad_s"),
}
# of one log alone, or known better by the sensor's makers: only where surely other than assumed
ONLY_WHERE_SIGNIFICANT = ("clock_drift", "turn_period")


def settings_of(calibration: Calibration) -> Settings:
    """Stage, key and value of all that is observable and that a setting exists for."""
    told = {
        e.name: round(float(e.value), 9 if e.name == "clock_drift" else 6)
        for e in calibration.estimates
        if e.name in KEYS and (e.significant if e.name in ONLY_WHERE_SIGNIFICANT else e.observable)
    }
    out: Settings = {}
    for name, value in told.items():
        stage, key = KEYS[name]
        out.setdefault(stage, {})[key] = value
    sensor: Values = {}
    ranges = calibration.range_errors
    if ranges is not None and ranges.significant:
        sensor["range_error_m"] = tuple(round(float(error_m), 4) for error_m in ranges.values_m)
        sensor["range_error_step_m"] = ranges.step_m
    if "turn_period" in told:
        sensor["reversed_beams"] = told["turn_period"] < 0.0
        sensor["turn_period_s"] = abs(told["turn_period"])
    if "delay" in told:  # that at the start of the log
        drift = told.get("clock_drift", calibration.config.sensor.clock_drift)
        sensor["transport_delay_s"] = round(told["delay"] + drift * calibration.middle_s, 6)
    if sensor:
        out.setdefault("sensor", {}).update(sensor)
    if calibration.start.words:
        out.setdefault("wheels", {}).update(_sides(calibration))
    return out


def _sides(calibration: Calibration) -> dict[str, float | bool]:
    """Which wheel is which, and which of them counts backwards."""
    (left, right), now = calibration.start.signs, calibration.config.wheels
    swapped = left[0] == 0.0
    reversed_now = (now.left_reversed, now.right_reversed)
    left_now, right_now = reversed(reversed_now) if swapped else reversed_now
    out: dict[str, float | bool] = {"swap_sides": not now.swap_sides} if swapped else {}
    return out | {
        "left_reversed": bool(left_now ^ (left.sum() < 0.0)),
        "right_reversed": bool(right_now ^ (right.sum() < 0.0)),
    }


def yaml_of(calibration: Calibration, logs: str) -> str:
    """A file for ``--config``."""
    out = [f"# By `mfslam calibrate {logs}`: one sigma and what was assumed before stand beside each value."]
    names = {key: name for name, (_, key) in KEYS.items()}
    settings = settings_of(calibration)
    for stage, values in settings.items():
        out.append(f"{stage}:")
        for key, value in values.items():
            text = _as_text(value)
            beside = ""
            if key in names:
                e = calibration[names[key]]
                beside = f"   # +- {e.sigma:.2g}, was {e.before:.6g}"
            out.append(f"  {key}: {text}{beside}")
    written = {key for values in settings.values() for key in values}
    for e in calibration.estimates:
        if e.name not in KEYS or KEYS[e.name][1] not in written:
            out.append(f"# {e.line()}")
    if calibration.range_errors is not None and "range_error_m" not in written:
        out.append(f"# {calibration.range_errors.line()}")
    return "\n".join(out) + "\n"


def _as_text(value: float | bool | tuple[float, ...]) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_as_text, value))}]"
    return str(value).lower() if isinstance(value, bool) else f"{value:.6g}"


def applied(config: Config, calibration: Calibration) -> Config:
    """The config with all that was found."""
    found = settings_of(calibration)
    return config.model_copy(
        update={stage: getattr(config, stage).model_copy(update=values) for stage, values in found.items()}
    )
