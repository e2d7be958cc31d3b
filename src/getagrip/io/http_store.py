"""Stores at http:// and https:// addresses: no answer is longer than asked for, and none comes from another server."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping

from getagrip.errors import InputError

HTTP_PROTOCOLS = ("http", "https")
MAX_LISTING_BYTES = 64 * 2**20
"""Bytes of an answer to what asks for no range, such as a folder's page."""


def fsspec_options(url: str) -> dict[str, object]:
    """Return fsspec's options for the protocols in an address; empty where there are none."""
    return {
        kind: {"client_kwargs": _client_arguments()} for kind in HTTP_PROTOCOLS if re.search(rf"(^|::){kind}://", url)
    }


def asked_bytes(headers: Mapping[str, str]) -> int | None:
    """Return the number of bytes a request asks for; None where it does not say."""
    asked = re.fullmatch(r"bytes=(\d+)-(\d+)", headers.get("Range", ""))
    return None if asked is None else int(asked[2]) - int(asked[1]) + 1


@functools.cache
def _client_arguments() -> dict[str, object]:
    """Arguments of aiohttp's ``ClientSession``."""
    import aiohttp

    class Bounded(aiohttp.ClientResponse):  # type: ignore[misc]
        """An answer of which no more is read than was asked for: servers may ignore ranges, and bodies never end."""

        _body: bytes | None = None

        async def read(self) -> bytes:
            body = self._body
            if body is None:
                asked = asked_bytes(self.request_info.headers)
                left = MAX_LISTING_BYTES + 1 if asked is None else asked
                parts: list[bytes] = []
                while left and (part := await self.content.read(left)):
                    parts.append(part)
                    left -= len(part)
                if not left:
                    self.close()
                    if asked is None:
                        raise InputError(
                            str(self.url), "", f"more than {MAX_LISTING_BYTES} bytes", "at most that in a listing"
                        )
                self._body = body = b"".join(parts)
            return body

    async def same_server(session: object, context: object, redirect: aiohttp.TraceRequestRedirectParams) -> None:
        target = redirect.response.headers.get("Location") or redirect.response.headers.get("URI") or ""
        if redirect.url.join(type(redirect.url)(target)).origin() != redirect.url.origin():
            raise InputError(str(redirect.url), "", f"a redirect to {target[:200]!r}", "files of the same server")

    trace = aiohttp.TraceConfig()
    trace.on_request_redirect.append(same_server)
    return {"response_class": Bounded, "trace_configs": [trace]}
