"""Files requested by a page; each is served once, at an address that cannot be guessed."""

from __future__ import annotations

import secrets
from collections import OrderedDict
from collections.abc import AsyncIterable, Callable, Iterable
from dataclasses import dataclass

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse

from ikservo.clock import Clock

_VALID_S = 30.0
_MAX_OFFERS = 16


@dataclass(frozen=True, slots=True)
class Download:
    """A file that is made when it is fetched.

    Attributes:
        name: The name of the file; empty if the page displays the file instead of saving it.
        make: Yields the file in parts; text parts are made in a separate thread.
        media_type: The media type.
    """

    name: str
    make: Callable[[], Iterable[str] | AsyncIterable[bytes]]
    media_type: str = "text/csv"


class DownloadOffers:
    """Addresses of files, each valid once and briefly; a download cannot authenticate by key."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._offers: OrderedDict[str, tuple[float, Download]] = OrderedDict()

    def offer(self, download: Download) -> str:
        """Return the address, relative to the page, at which a file can be fetched once."""
        token = secrets.token_urlsafe(24)
        self._offers[token] = (self._clock.now_s() + _VALID_S, download)
        while len(self._offers) > _MAX_OFFERS:
            self._offers.popitem(last=False)
        return f"download/{token}"

    async def serve(self, request: Request) -> Response:
        """Return the file at an address, or 404 if the address is unknown, used or expired."""
        until_s, download = self._offers.pop(request.path_params["token"], (0.0, None))
        if download is None or self._clock.now_s() > until_s:
            return PlainTextResponse(
                "This download link was already used or has expired.\n", status_code=404
            )
        attachment = f'attachment; filename="{download.name}"'
        headers = {"content-disposition": attachment} if download.name else {}
        return StreamingResponse(download.make(), media_type=download.media_type, headers=headers)
