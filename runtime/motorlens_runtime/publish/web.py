"""`web://127.0.0.1:9465`: the live page of `motorlens monitor`, served by the runtime itself; see `monitor`.

Serves this machine only, and only a browser that knows the key in the address, which is printed on standard error. Options:
`key_file=FILE` keeps one key over restarts, in a file that only its user may read, made where there is none (a key on the
command line would be read by everybody on this machine); `token=` lets every program on this machine in; `open=1` opens a
browser. Without a port, a free one is taken.
"""

import os
import secrets
from contextlib import suppress
from pathlib import Path
from urllib.parse import SplitResult, parse_qsl

from motorlens_runtime.errors import DataError
from motorlens_runtime.monitor.page import MonitorPage
from motorlens_runtime.options import Options
from motorlens_runtime.publish import Header, address_of
from motorlens_runtime.web.browser import announce


def open_url(url: SplitResult, header: Header) -> MonitorPage:
    """See `publish`."""
    pairs = {k: v for k, v in parse_qsl(url.query, keep_blank_values=True) if k not in ("rate", "decimate")}
    options = Options(pairs, f"{url.scheme}://{url.netloc}")
    if options.text("token", ""):
        raise DataError(
            f"{url.scheme}: a key on the command line is read by everybody here; write key_file=FILE"
        )
    token = "" if "token" in pairs else None
    if kept := options.text("key_file", ""):
        token = _kept(Path(kept))
    opened = options.integer("open", 0, 0, 1) == 1
    options.finish()
    host, port = address_of(url, 0)
    if host not in ("127.0.0.1", "localhost"):
        raise DataError(
            f"{url.geturl()}: the page serves this machine only; from another one use ssh -L, udp:// or mqtt://"
        )
    page = MonitorPage(header, port, token)
    announce("monitor", page.url, page.url_for_once() if opened else None)
    return page


def _kept(path: Path) -> str:
    """The key in a file; a new one, made for this user alone, where there is none."""
    try:
        with suppress(FileExistsError):
            with open(
                os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii"
            ) as file:
                file.write(secrets.token_urlsafe(24) + "\n")
        if path.stat().st_mode & 0o077:
            raise DataError(f"{path}: other users may read or change it; chmod 600 {path}")
        token = path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(
            f"{path}: cannot keep the key there: {getattr(error, 'strerror', None) or error}"
        ) from None
    if len(token) < 16:
        raise DataError(f"{path}: a key has at least 16 characters; remove the file and a good one is made")
    return token
