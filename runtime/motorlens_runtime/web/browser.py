"""Telling the user where a page is, and opening it."""

import sys
import threading
import webbrowser


def announce(command: str, url: str, once: str | None) -> None:
    """Print the address of a page on standard error; open `once`, an address good for one time, in the user's browser."""
    print(f"motorlens {command}: {url}", file=sys.stderr, flush=True)
    if once is not None:
        # A browser that must be started first takes its time.
        threading.Thread(target=webbrowser.open, args=(once,), daemon=True).start()
