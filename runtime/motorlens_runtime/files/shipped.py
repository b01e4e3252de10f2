"""Motor files and sensors that come with motorlens, by their bare name: `--motor mellah2016`, `--sensor mellah2016`."""

import difflib
from pathlib import Path

from motorlens_runtime.errors import ModelError

_SUFFIX = {"motors": ".toml", "sensors": ".onnx"}


def motor_path(name: str | Path) -> Path:
    """A motor file: the path as it stands, or the shipped one of that name. Raises ModelError if there is neither."""
    return _path(name, "motors")


def sensor_path(name: str | Path) -> Path:
    """A sensor file: the path as it stands, or the shipped one of that name. Raises ModelError if there is neither."""
    return _path(name, "sensors")


def shipped(kind: str) -> dict[str, Path]:
    """What comes with motorlens, "motors" or "sensors", by name."""
    suffix = _SUFFIX[kind]
    files = sorted((_folder() / kind).glob(f"*{suffix}"))
    return {file.stem: file for file in files if not file.stem.endswith(".step")}


def _path(name: str | Path, kind: str) -> Path:
    path = Path(name)
    # What has a suffix or a folder is a path; so is what is there.
    if path.suffix or len(path.parts) != 1 or path.exists():
        return path
    known = shipped(kind)
    if path.name not in known:
        near = difflib.get_close_matches(path.name, known, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(known) or 'none'}"
        raise ModelError(f"{name}: no such file, and none of the {kind} that come with motorlens; {hint}")
    return known[path.name]


def _folder() -> Path:
    """In the wheel the models lie within the package, in a checkout beside it."""
    inside = Path(__file__).resolve().parents[1] / "models"
    return inside if inside.is_dir() else Path(__file__).resolve().parents[3] / "models"
