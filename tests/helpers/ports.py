"""Ports for servers that must be told theirs: a port is found free, let go, and taken by the server a moment later.

On 127.0.0.1 any program may take it in between. All of 127.0.0.0/8 is this machine, so each process of tests has an address
of its own there, where nobody else listens.
"""

import os
import socket


def own_address() -> str:
    """An address of this machine that no other process uses; a process number has at most 22 bits."""
    number = os.getpid()
    return f"127.{64 + (number >> 16)}.{number >> 8 & 255}.{number & 255}"


def free_place(kind: socket.SocketKind = socket.SOCK_STREAM) -> str:
    """`host:port` at which nobody listens but who is told of it."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind((own_address(), 0))
        host, port = probe.getsockname()
    return f"{host}:{port}"
