"""Worlds by name: those that ship with mfslam, files, and random offices by their seed."""

from __future__ import annotations

from pathlib import Path

from drivers.simulator.offices import random_office_text
from drivers.simulator.world import DEFAULT_SPEED_M_S, World, parse_world
from mfslam.settings import did_you_mean
from mfslam.types import MfslamError

OFFICE = "office:SEED[:ROOMS[:LAPS]]"  # how a random office is asked for


def world_names() -> list[str]:
    """Names of the worlds that ship with mfslam."""
    return sorted(p.stem for p in _shipped().glob("*.world"))


def load_world(name: str | Path, default_speed_m_s: float = DEFAULT_SPEED_M_S) -> World:
    """A shipped world by its name, a random one as ``office:SEED[:ROOMS[:LAPS]]``, or a file by its path.

    ``ROOMS`` (5) on each side of the corridor; ``default_speed_m_s``: where the world states none.
    """
    text, called = world_text(name, default_speed_m_s)
    return parse_world(text, called, default_speed_m_s)


def world_text(name: str | Path, default_speed_m_s: float = DEFAULT_SPEED_M_S) -> tuple[str, str]:
    """The text of a world, and what to call it."""
    if str(name).startswith("office:"):
        return _office_text(str(name), default_speed_m_s), str(name)
    path = _shipped() / f"{name}.world"
    if not path.is_file():
        path = Path(name)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        hint = did_you_mean(str(name), world_names()) or "."
        raise MfslamError(
            f"no world and no file {str(name)!r}{hint} Worlds: {', '.join(world_names())}, {OFFICE}"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "binary data"
        raise MfslamError(f"{path}: expected a world text file: {reason}") from None
    return text, path.stem if path.parent == _shipped() else str(path)


def _office_text(name: str, speed_m_s: float) -> str:
    words = name.split(":")[1:]
    try:
        seed, rooms, laps = [int(word) for word in words] + [5, 1][len(words) - 1 :]
    except ValueError:
        raise MfslamError(f"{name}: expected {OFFICE} in whole numbers, for example office:7:60:3") from None
    if seed < 0 or rooms < 1 or laps < 1:
        raise MfslamError(
            f"{name}: expected {OFFICE} with a seed of at least 0, rooms and laps of at least 1"
        )
    return random_office_text(seed, rooms, laps, speed_m_s)


def _shipped() -> Path:
    return Path(__file__).resolve().parent / "worlds"
