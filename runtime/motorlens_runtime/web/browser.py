"""Telling the user where a page is, and opening it."""

import sys
import threading
import webbrowser


def announce(command: str, url: str, opened: bool) -> None:
    """Print the address of a page on standard error; if `opened`, open the user's browser there too."""
    print(f"motorlens {command}: {url}", file=sys.stderr, flush=True)
    if opened:
        # A browser that must be started first takes its time.
        threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
