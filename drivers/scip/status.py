"""What the sensor's codes mean: status of a reply, and values that stand in the place of a range."""

from __future__ import annotations

OK, STREAMED, ALREADY_ON, LASER_OFF, CHECKED_RESUMED = "00", "99", "02", "10", "98"

_GENERIC = {
    "0A": "internal: unable to create transmission data",
    "0B": "buffer shortage, or command repeated that is already processed",
    "0C": "command with insufficient parameters (1)",
    "0D": "undefined command (1)",
    "0E": "undefined command, or already in SCIP 2.0",
    "0F": "command with insufficient parameters (2)",
    "0G": "string in the command has more than 16 characters",
    "0H": "string has invalid letters",
    "0I": "sensor is in firmware update mode",
}
_MEASURE = {
    "01": "starting step is no number",
    "02": "end step is no number",
    "03": "cluster count is no number",
    "04": "end step out of range",
    "05": "end step smaller than starting step",
    "06": "scan interval is no number",
    "07": "number of scans is no number",
    "10": "laser is off (send BM first)",
}
_OF_COMMAND = {
    "MD": _MEASURE,
    "MS": _MEASURE,
    "GD": _MEASURE,
    "GS": _MEASURE,
    "BM": {"01": "laser cannot be controlled, or malfunctions", "02": "laser is on already"},
    "SS": {
        "01": "bit rate has letters that are no numbers",
        "02": "bit rate is not supported",
        "03": "sensor has this bit rate already",
        "04": "not compatible with the sensor's model",
    },
    "TM": {
        "01": "control code is no number",
        "02": "adjust mode is on already",
        "03": "adjust mode is off already",
        "04": "adjust mode is off",
    },
    "CR": {"01": "motor speed out of range", "02": "motor has this speed already", "03": "not supported"},
}


def meaning(command: str, status: str) -> str:
    """A reply's status in words; ``command`` are its two letters."""
    if status == OK:
        return "accepted"
    known = _OF_COMMAND.get(command, {}).get(status) or _GENERIC.get(status)
    if known is not None:
        return known
    if command in ("MD", "MS", "GD", "GS") and status.isdigit():
        number = int(status)
        if 21 <= number <= 49:
            return "measuring stopped: the sensor verifies an error"
        if 50 <= number <= 97:
            return "hardware trouble: laser, motor or the like"
        if number == 98:
            return "measuring resumed: the sensor found itself in order"
        if number == 99:
            return "scan follows"
    return "unknown status"


def is_hardware_trouble(status: str) -> bool:
    return status.isdigit() and 50 <= int(status) <= 97


def is_being_verified(status: str) -> bool:
    """The sensor has stopped to look into an error; 98 tells that it goes on."""
    return status.isdigit() and 21 <= int(status) <= 49


_RANGE_CODES = {
    0: "nothing found, or farther than the sensor sees",
    1: "intensity too low",
    2: "intensity too low",
    6: "other error",
    7: "neighbouring steps have errors",
    8: "two echoes",
    9: "the same step had an error in the last two scans",
    18: "strong reflector",
    19: "step is not measured",
}


def range_code(value: int) -> str:
    """A value below the sensor's shortest range (DMIN), in words: it is no range."""
    return _RANGE_CODES.get(value, "other error")
