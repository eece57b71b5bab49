"""The RPLIDAR protocol on the level of bytes. No I/O.

Source: Slamtec, RPLIDAR Interface Protocol and Application Notes (LR001). A request is 0xA5, a command and, where it has
one, a payload with its length and the XOR of all before. An answer begins with a descriptor of seven bytes that
tells its size and type. Measured points, five bytes each, then come until STOP, without further framing.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mfslam.types import FloatArray

STOP, RESET, SCAN, INFO, HEALTH = 0x25, 0x40, 0x20, 0x50, 0x52
MOTOR_RPM, MOTOR_PWM, ADAPTER_FLAGS = 0xA8, 0xF0, 0xFF
INFO_ANSWER, HEALTH_ANSWER, SCAN_ANSWER, ADAPTER_ANSWER = 0x04, 0x06, 0x81, 0xFF
SIZES = {INFO_ANSWER: 20, HEALTH_ANSWER: 3, SCAN_ANSWER: 5, ADAPTER_ANSWER: 4}
POINT_BYTES = 5
_DESCRIPTOR = struct.Struct("<HIB")
_START = 0x5AA5
_SIZE_MASK = (1 << 30) - 1  # the two high bits tell whether one answer follows or many
_FULL_TURN = 360 * 64
_SURE_POINTS = 4  # whose check bits must be right before bytes are believed to be points again


def request(command: int, payload: bytes = b"") -> bytes:
    text = bytes([0xA5, command])
    if payload:
        text += bytes([len(payload)]) + payload
        checksum = 0
        for byte in text:
            checksum ^= byte
        text += bytes([checksum])
    return text


def descriptor(kind: int, many: bool = False) -> bytes:
    """What begins an answer of this type."""
    return _DESCRIPTOR.pack(_START, SIZES[kind] | many << 30, kind)


def answer_in(data: bytes, kind: int) -> bytes | None:
    """The payload of the first answer of this type that is whole, of a scan what has come after its begin; None where
    there is none."""
    at = -1
    while (at := data.find(b"\xa5\x5a", at + 1)) >= 0 and len(data) - at >= _DESCRIPTOR.size:
        _, size, found = _DESCRIPTOR.unpack_from(data, at)
        begin = at + _DESCRIPTOR.size
        if found == kind and size & _SIZE_MASK == SIZES[kind]:
            if kind == SCAN_ANSWER:
                return data[begin:]
            if len(data) - begin >= SIZES[kind]:
                return data[begin : begin + SIZES[kind]]
    return None


@dataclass(frozen=True)
class Info:
    """What the sensor is. ``model``: its high four bits are the series (1 to 3: A1 to A3; 4: C1; 6 to 8: S1 to S3)."""

    model: int
    firmware: tuple[int, int]
    serial: str

    @property
    def series(self) -> int:
        return self.model >> 4

    @staticmethod
    def of(payload: bytes) -> Info:
        model, minor, major = payload[:3]
        return Info(model, (major, minor), payload[4:].hex().upper())


def point(angle_deg: float, range_mm: float, begins: bool, quality: int = 47) -> bytes:
    """A measured point as it is sent; ``begins``: the first of a turn."""
    head = quality << 2 | (1 if begins else 2)
    return struct.pack("<BHH", head, round(angle_deg * 64) % _FULL_TURN << 1 | 1, round(range_mm * 4))


@dataclass(frozen=True, eq=False)
class Points:
    """``angles_deg`` (N,), ``ranges_mm`` (N,) 0 for nothing; ``after`` (N,): bytes that had come after each by then."""

    angles_deg: FloatArray
    ranges_mm: FloatArray
    after: FloatArray


class PointParser:
    """Feeds on bytes in any pieces, gives whole points. Three bits of forty check each: after bytes that are no point,
    several in a row must be right. ``bent`` counts places where that was not so."""

    def __init__(self) -> None:
        self.bent = 0
        self._rest = b""
        self._sure = False

    def feed(self, chunk: bytes) -> Points:
        data, at, good = self._rest + chunk, 0, []
        while True:
            needed = POINT_BYTES if self._sure else _SURE_POINTS * POINT_BYTES
            if len(data) - at < needed:
                break
            whole = (len(data) - at) // POINT_BYTES * POINT_BYTES
            words = np.frombuffer(data[at : at + whole], np.uint8).reshape(-1, POINT_BYTES)
            wrong = ~_is_point(words)
            count = int(wrong.argmax()) if wrong.any() else len(words)
            if self._sure or count >= _SURE_POINTS:
                self._sure = True
                good.append((words[:count], len(data) - at))
                at += count * POINT_BYTES
            if count < len(words):
                self.bent += self._sure
                self._sure = False
                at += 1
        self._rest = data[at:]
        return _points(good)


def _is_point(words: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    """(N,) whether rows (N, 5) have their check bits right and an angle of less than a turn."""
    flags = (words[:, 0] ^ words[:, 0] >> 1) & words[:, 1] & 1
    return np.asarray((flags == 1) & (_angles(words) < 360.0))


def _angles(words: npt.NDArray[np.uint8]) -> FloatArray:
    return np.asarray((words[:, 1].astype(np.float64) // 2 + 128.0 * words[:, 2]) / 64.0)


def _points(parts: list[tuple[npt.NDArray[np.uint8], int]]) -> Points:
    if not parts:
        return Points(*(np.zeros(0) for _ in range(3)))
    words = np.concatenate([part for part, _ in parts])
    after = np.concatenate([left - POINT_BYTES * (1.0 + np.arange(len(part))) for part, left in parts])
    ranges_mm = (words[:, 3].astype(np.float64) + 256.0 * words[:, 4]) / 4.0
    return Points(_angles(words), ranges_mm, after)
