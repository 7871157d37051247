# SPDX-License-Identifier: BSD-3-Clause
"""Who may ask a server of ours by HTTP: no page from elsewhere, and by no stranger's name."""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Sequence

#: Names that only this computer has; through a tunnel its port may be another.
LOCAL_NAMES = ("127.0.0.1", "localhost", "::1")
#: Each connection has a thread, and what it is given in memory.
MOST_CONNECTIONS = 16
#: A name or an address, that of IPv6 in brackets, and perhaps a port; nothing else is a Host (RFC 9110, 7.2).
_HOST = re.compile(r"(?P<name>\[[0-9A-Fa-f:.]+\]|[0-9A-Za-z.-]+)(?::[0-9]{1,5})?")


def why_not(hosts: Sequence[str], origins: Sequence[str], *, only_here: bool = True) -> str | None:
    """Why a request is refused, None if it is not.

    The name of a stranger's server may lead here, and a stranger's page may call here: the first is seen by
    ``Host``, which must be a name of this computer, the second by ``Origin``, which must be the same.

    `hosts`, `origins`: What the request says, each time it says it.
    `only_here`: Whether only this computer may ask; else ``Host`` may be an address, or a name that only a
        network nearby gives.
    """
    if len(hosts) != 1 or len(origins) > 1:
        return "expected one Host, and one Origin at most"
    found = _HOST.fullmatch(hosts[0])
    name = found["name"].strip("[]").lower() if found else ""
    if name not in LOCAL_NAMES and (only_here or not _is_near(name)):
        also = "" if only_here else ", an address, or a name of this computer"
        return f"expected {', '.join(LOCAL_NAMES)}{also} as Host"
    if origins and origins[0].lower() != f"http://{hosts[0].lower()}":
        return "pages from elsewhere may not ask"
    return None


def _is_near(name: str) -> bool:
    """Whether a name is an address, or no name of the internet, or that of this computer."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        is_of_internet = "." in name.removesuffix(".local")
        return bool(name) and (not is_of_internet or name == socket.gethostname().lower())
    return True
