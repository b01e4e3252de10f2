"""Where the real recordings are, and how a test says that they are not here."""

from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2].parent / "shared" / "recordings"

needs_recordings = pytest.mark.skipif(
    not FOLDER.is_dir(),
    reason="the real recordings are not here (a folder shared/recordings beside the checkout)",
)


def regbot(robot: int) -> Path:
    """The run of one robot; the left wheel's motor is vL_V, iL_A, wL_rad_s."""
    return FOLDER / "regbot" / f"robot_{robot:02d}.csv"


REGBOT_LEFT = ("voltage=vL_V", "current=iL_A", "speed=wL_rad_s")
REGBOT_RIGHT = ("voltage=vR_V", "current=iR_A", "speed=wR_rad_s")
