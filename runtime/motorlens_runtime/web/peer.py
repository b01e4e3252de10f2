"""Whose program is at the other end of a connection within this machine: Linux tells by NETLINK_SOCK_DIAG (sock_diag(7))."""

import socket
import struct
from contextlib import suppress

_NETLINK_SOCK_DIAG = 4
_SOCK_DIAG_BY_FAMILY, _NLM_F_REQUEST = 20, 1
# struct nlmsghdr; struct inet_diag_req_v2 down to its id; struct inet_diag_sockid, whose ports and addresses are in
# network order; of struct inet_diag_msg the part before its id, and from its end to the user.
_HEADER = struct.Struct("=IHHII")
_QUESTION = struct.Struct("=BBBBI")
_ENDS = struct.Struct("=2s2s4s12x4s12xI8s")
_BEFORE = struct.Struct("=BBBB")
_AFTER = struct.Struct("=IIII")


def user_of(line: socket.socket) -> int | None:
    """The number of the user whose program is at the other end of a TCP connection over 127.0.0.1.

    None where the kernel does not say: on another system, or when the other end has gone.
    """
    with suppress(OSError, AttributeError, struct.error):
        (there, there_port), (here, here_port) = line.getpeername(), line.getsockname()
        ends = _ENDS.pack(
            there_port.to_bytes(2), here_port.to_bytes(2), socket.inet_aton(there), socket.inet_aton(here), 0, b"\xff" * 8
        )  # fmt: skip
        question = _QUESTION.pack(socket.AF_INET, socket.IPPROTO_TCP, 0, 0, 0xFFFFFFFF) + ends
        header = _HEADER.pack(_HEADER.size + len(question), _SOCK_DIAG_BY_FAMILY, _NLM_F_REQUEST, 0, 0)
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _NETLINK_SOCK_DIAG) as kernel:
            kernel.settimeout(1.0)
            kernel.send(header + question)
            answer = kernel.recv(4096)
        if _HEADER.unpack_from(answer)[1] == _SOCK_DIAG_BY_FAMILY:
            *_, user = _AFTER.unpack_from(answer, _HEADER.size + _BEFORE.size + _ENDS.size)
            return int(user)
    return None
