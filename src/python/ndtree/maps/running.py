# SPDX-License-Identifier: BSD-3-Clause
"""A map that grows elsewhere, as a live mapper serves it."""

from __future__ import annotations

import urllib.error
import urllib.request
from urllib.parse import urlsplit

from ndtree._native._core import AdaptiveMap, FixedMap, from_bytes

#: A server that says nothing for so long counts as gone [s].
PATIENCE = 10.0
#: The largest file that is taken [bytes].
MOST = 1 << 32


class RunningMap:
    """The map of a live mapper on this or another computer.

    `url`: As the mapper says it: ``http://robot:8090``.
    Raises ValueError if it is no address.
    """

    def __init__(self, url: str) -> None:
        if not is_address(url) or not urlsplit(url).hostname:
            raise ValueError(f"{url}: expected an address as http://robot:8090")
        self.url = url.rstrip("/")
        self._tag = ""

    def newest(self) -> AdaptiveMap | FixedMap | None:
        """The map as it is now; None where it is as it was, or where there is none yet.

        Raises OSError if there is no answer, or one that is no map.
        """
        request = urllib.request.Request(f"{self.url}/map.ndt", headers={"If-None-Match": self._tag})
        try:
            with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
                data, tag = answer.read(MOST), answer.headers.get("ETag", "")
        except urllib.error.HTTPError as error:
            if error.code in (304, 503):
                return None
            raise OSError(f"{self.url}: answers {error.code}, expected a live map of ndtree") from None
        except OSError as error:
            reason = getattr(error, "reason", error)
            reason = getattr(reason, "strerror", None) or reason
            raise OSError(f"{self.url}: {reason}, expected a live map of ndtree to answer") from None
        try:
            m = from_bytes(data)
        except (RuntimeError, ValueError) as error:
            raise OSError(f"{self.url}: {error}, expected a live map of ndtree") from None
        self._tag = tag
        return m


def is_address(name: str) -> bool:
    """Whether something is an address, and no file."""
    return name.startswith(("http://", "https://"))
