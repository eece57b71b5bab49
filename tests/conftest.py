"""Fixtures for all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of recorded logs: ``../shared/data`` beside the checkout, or $MFSLAM_DATA. Never in the repository."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("MFSLAM_DATA", beside))
    if not folder.is_dir():
        pytest.skip(f"no recorded logs at {folder}: set MFSLAM_DATA to their folder")
    return folder
