"""Pages for a browser on this machine: a server on loopback behind a token, and the style that all pages share."""

from importlib.resources import files


def style() -> str:
    """The style sheet of every page."""
    return asset("motorlens_runtime.web", "style.css").decode()


def asset(package: str, name: str) -> bytes:
    """A file that lies beside a package's code."""
    return files(package).joinpath(name).read_bytes()
