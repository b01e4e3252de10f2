"""All that a drive PC without network needs, in one directory: wheels, sensor, settings, service, scripts, checksums.

The wheels are fetched here for the machine there (its processor, C library and Python), binary ones only: nothing is
compiled and nothing is run on the way. pip comes along too, as a wheel, so the target needs Python and nothing else.
"""

import base64
import hashlib
import json
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from importlib.metadata import Distribution, distribution
from pathlib import Path
from urllib.parse import unquote, urlsplit

from motorlens_runtime.errors import DataError, DeviceError
from motorlens_runtime.sensor.core_library import compile_core, compilers
from motorlens_runtime.sensor.sensor import load_sensor

MACHINES = ("x86_64", "aarch64")
# What a publisher or source needs beyond the light runtime.
_NEEDS = {
    "mqtt": "paho-mqtt",
    "parquet": "pyarrow",
    "can": "cantools",
    "opcua": "asyncua",
    "mcap": "mcap",
}
_FILES = ("motorlens.service", "99-motorlens.rules", "install.sh", "uninstall.sh")


@dataclass(frozen=True)
class Target:
    """The PC there: processor, Python `major.minor`, and the oldest glibc (minor of version 2) it may have."""

    machine: str = platform.machine()
    python: str = f"{sys.version_info[0]}.{sys.version_info[1]}"
    glibc_minor: int = 31

    def pip_arguments(self) -> list[str]:
        """What makes pip choose wheels for it."""
        tags = [f"manylinux_2_{minor}_{self.machine}" for minor in range(self.glibc_minor, 4, -1)]
        tags += [
            f"manylinux2014_{self.machine}",
            f"manylinux2010_{self.machine}",
            f"manylinux1_{self.machine}",
        ]
        arguments = ["--only-binary=:all:", "--implementation=cp", f"--python-version={self.python}"]
        arguments.append(f"--abi=cp{self.python.replace('.', '')}")
        arguments += ["--abi=abi3", "--abi=none"]
        return arguments + [f"--platform={tag}" for tag in tags]


def write_bundle(
    folder: Path, sensor_path: Path, target: Target, source: str, publish: Sequence[str], options: Sequence[str],
    wheels_from: Path | None = None,
) -> dict[str, object]:  # fmt: skip
    """Write a bundle into an empty or absent folder; returns what is in it.

    Args:
        folder: where to.
        sensor_path: the sensor, which is verified.
        target: the PC it is for.
        source, publish, options: what `motorlens run` is to be called with there; they stand in a file of settings.
        wheels_from: a folder of wheels to take instead of a package index.

    Raises:
        ModelError: the sensor is not sound.
        DataError: the folder is not empty, or a setting cannot be written.
        DeviceError: the wheels cannot be had.
    """
    sensor = load_sensor(sensor_path)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise DataError(f"{folder}: is not empty; name a new directory")
    needs = [need for url in (source, *publish) if (need := _NEEDS.get(urlsplit(url).scheme))]
    settings = environment_file(
        source, [part for url in publish for part in ("--publish", url)] + list(options)
    )
    wheels = folder / "wheels"
    wheels.mkdir(parents=True)
    own = own_wheel(wheels)
    requirements = [own_requirement(need) for need in sorted(set(needs))]
    _download([str(own.resolve()), "pip", *requirements], wheels, target, wheels_from)
    (folder / sensor_path.name).write_bytes(sensor_path.read_bytes())
    (folder / "motorlens.env").write_text(settings, encoding="utf-8")
    words = {
        "@SENSOR@": sensor_path.name, "@NAME@": sensor.name, "@MACHINE@": target.machine, "@PYTHON@": target.python,
        "@REQUIREMENTS@": " ".join(f'"{each}"' for each in ("motorlens", *requirements)),
    }  # fmt: skip
    has_core = _core_for(target, folder)
    for name in _FILES:
        text = resources.files(__package__).joinpath("bundle_files", name).read_text(encoding="utf-8")
        for word, value in words.items():
            text = text.replace(word, value)
        (folder / name).write_text(text, encoding="utf-8")
        if name.endswith(".sh"):
            (folder / name).chmod(0o755)
    sums = checksums(folder)
    (folder / "SHA256SUMS").write_text(sums, encoding="utf-8")
    files = [line.split("  ", 1)[1] for line in sums.splitlines()]
    return {
        "schema": "motorlens.bundle/1", "folder": str(folder), "sensor": sensor.name, "sensor_sha256": sensor.digest,
        "machine": target.machine, "python": target.python, "core": has_core, "files": files,
        "bytes": sum((folder / name).stat().st_size for name in files),
    }  # fmt: skip


def _core_for(target: Target, folder: Path) -> bool:
    """Compile the C core for that machine, if there is a compiler for it; whether it is in the bundle."""
    own = target.machine == platform.machine()
    names = compilers() if own else [shutil.which(f"{target.machine}-linux-gnu-gcc")]
    compiler = next(filter(None, names), None)
    if compiler is None:
        return False
    try:
        compile_core(compiler, folder / f"motorlens-{target.machine}.so")
    except (OSError, subprocess.SubprocessError):
        return False
    return True


def environment_file(source: str, options: Sequence[str]) -> str:
    """The settings as systemd reads them (systemd.exec(5), EnvironmentFile).

    Raises:
        DataError: a value holds a blank or a line break, at which systemd would cut it.
    """
    for value in (source, *options):
        if re.search(r"[\s\"'\\$]", value):
            raise DataError(
                f"setting {value!r}: blanks, quotes, $ and \\ cannot stand in the settings of a service"
            )
    return (
        "# Settings of the motorlens service; after a change: systemctl restart motorlens\n"
        "# Where the samples come from: serial:///dev/ttyUSB0?baud=921600, serial://SERIAL-NUMBER, tcp://HOST:PORT, ...\n"
        f'MOTORLENS_SOURCE="{source}"\n'
        "# Everything else `motorlens run` takes: --publish URL (may be repeated), --rate HZ, ...\n"
        f'MOTORLENS_OPTIONS="{" ".join(options)}"\n'
    )


def checksums(folder: Path) -> str:
    """SHA-256 of every file below a folder, as `sha256sum --check` reads it."""
    lines = []
    for path in sorted(p for p in folder.rglob("*") if p.is_file() and p.name != "SHA256SUMS"):
        lines.append(
            f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(folder).as_posix()}\n"
        )
    return "".join(lines)


def own_wheel(folder: Path) -> Path:
    """motorlens itself as a wheel: built from its source if it is installed for development, else packed from its files."""
    installed = distribution("motorlens")
    source = _source_of(installed)
    if source is None:
        return pack_installed(installed, folder)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps"]
    try:
        import hatchling  # noqa: F401  # type: ignore[import-not-found]

        command.append("--no-build-isolation")
    except ModuleNotFoundError:
        pass
    _run([*command, "--wheel-dir", str(folder), str(source)], f"{source}: cannot be built")
    return next(folder.glob("motorlens-*.whl"))


def pack_installed(installed: Distribution, folder: Path) -> Path:
    """A wheel of the files that an installation lists as its own (PEP 427), without what its installer added."""
    added = {"INSTALLER", "RECORD", "REQUESTED", "direct_url.json"}
    name = f"motorlens-{installed.version}-py3-none-any.whl"
    information = f"motorlens-{installed.version}.dist-info"
    record = []
    with zipfile.ZipFile(folder / name, "w", zipfile.ZIP_DEFLATED) as wheel:
        for file in sorted(installed.files or [], key=str):
            # Scripts lie outside and are made anew from the entry points.
            if file.parts[0] == ".." or file.suffix == ".pyc" or file.name in added:
                continue
            data = Path(str(file.locate())).read_bytes()
            digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
            record.append(f"{file.as_posix()},sha256={digest},{len(data)}\n")
            wheel.writestr(zipfile.ZipInfo(file.as_posix(), (2020, 1, 1, 0, 0, 0)), data)
        record.append(f"{information}/RECORD,,\n")
        wheel.writestr(zipfile.ZipInfo(f"{information}/RECORD", (2020, 1, 1, 0, 0, 0)), "".join(record))
    return folder / name


def own_requirement(name: str) -> str:
    """How motorlens asks for a package in one of its extras, such as `paho-mqtt>=2.1`."""
    for line in distribution("motorlens").requires or []:
        specifier = line.partition(";")[0].strip()
        if re.split(r"[<>=!~\[ ]", specifier)[0] == name:
            return specifier
    return name


def _source_of(installed: Distribution) -> Path | None:
    """The folder of an editable installation, None for an ordinary one."""
    text = installed.read_text("direct_url.json")
    origin = json.loads(text) if text else {}
    if not origin.get("dir_info", {}).get("editable"):
        return None
    return Path(unquote(urlsplit(origin["url"]).path))


def _download(requirements: Sequence[str], folder: Path, target: Target, wheels_from: Path | None) -> None:
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
    command += [f"--dest={folder}", *target.pip_arguments()]
    if wheels_from is not None:
        command += ["--no-index", f"--find-links={wheels_from}"]
    _run([*command, *requirements], f"the wheels for {target.machine}, Python {target.python} cannot be had")


def _run(command: list[str], complaint: str) -> None:
    with tempfile.TemporaryDirectory() as nowhere:
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=nowhere)
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.startswith("ERROR")] or ["pip failed"]
        raise DeviceError(f"{complaint}: {lines[-1].removeprefix('ERROR: ')}")
