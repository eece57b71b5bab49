"""Lines of text logs for tests, built from figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

Pose = Sequence[float]


def _pose(pose: Pose) -> str:
    return " ".join(f"{v:.6f}" for v in pose)


def _tail(stamp_s: float) -> str:
    return f"{stamp_s:.6f} host {stamp_s - 1.0:.6f}"


def flaser(
    stamp_s: float, ranges: Iterable[object], odom: Pose, laser: Pose | None = None, word: str = "FLASER"
) -> str:
    texts = [str(r) for r in ranges]
    poses = f"{_pose(odom if laser is None else laser)} {_pose(odom)}"
    return f"{word} {len(texts)} {' '.join(texts)} {poses} {_tail(stamp_s)}"


def robotlaser(
    stamp_s: float,
    ranges: Iterable[object],
    robot: Pose,
    laser: Pose,
    *,
    geometry: str = "0 -1.570796 3.141593 0.017453 81.0 0.01 0",
    remissions: int = 0,
) -> str:
    texts = [str(r) for r in ranges]
    extra = " ".join([str(remissions), *["7"] * remissions])
    return (
        f"ROBOTLASER1 {geometry} {len(texts)} {' '.join(texts)} {extra} {_pose(laser)} {_pose(robot)} "
        f"0.1 0.2 0.5 0.5 1.0 {_tail(stamp_s)}"
    )


def rawlaser(stamp_s: float, ranges: Iterable[object]) -> str:
    texts = [str(r) for r in ranges]
    return f"RAWLASER1 0 -1.570796 3.141593 0.017453 81.0 0.01 0 {len(texts)} {' '.join(texts)} 0 {_tail(stamp_s)}"


def odom(stamp_s: float, pose: Pose) -> str:
    return f"ODOM {_pose(pose)} 0.1 0.0 0.0 {_tail(stamp_s)}"


def urg(stamp_us: int, left: object, right: object, ranges_mm: Sequence[object]) -> str:
    head = [stamp_us, 0, left, right, *[0] * 20]
    return " ".join(str(v) for v in [*head, *ranges_mm, 0])
