"""`web://127.0.0.1:9465`: the live page of `motorlens monitor`, served by the runtime itself; see `monitor`.

Serves this machine only, and only a browser that knows the key in the address, which is printed on standard error. Options:
`token=TEXT` is a key that stays the same (`token=` lets every program on this machine in), `open=1` opens a browser.
Without a port, a free one is taken.
"""

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
    fixed = "token" in pairs
    token = options.text("token", "")
    opened = options.integer("open", 0, 0, 1) == 1
    options.finish()
    host, port = address_of(url, 0)
    if host not in ("127.0.0.1", "localhost"):
        raise DataError(
            f"{url.geturl()}: the page serves this machine only; from another one use ssh -L, udp:// or mqtt://"
        )
    page = MonitorPage(header, port, token if fixed else None)
    announce("monitor", page.url, opened)
    return page
