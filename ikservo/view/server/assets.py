"""The files that the page is made of, and nothing beside them."""

from __future__ import annotations

from importlib.resources import files

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

__all__ = ["assets"]

_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}


def assets() -> list[Route]:
    """Return the routes on which a browser finds the page."""
    return [
        Route("/", _index, methods=["GET"]),
        Route("/page/{name}", _asset, methods=["GET"]),
    ]


async def _index(_: Request) -> Response:
    return _page_file("index.html")


async def _asset(request: Request) -> Response:
    return _page_file(request.path_params["name"])


def _page_file(name: str) -> Response:
    """Return one of the page's files; what is no plain name of one does not exist."""
    page = files("ikservo.view") / "page"
    known = {entry.name for entry in page.iterdir()}
    kind = _TYPES.get(name.rpartition(".")[2])
    if name not in known or kind is None:
        return PlainTextResponse("There is no such page.\n", status_code=404)
    return Response((page / name).read_bytes(), media_type=kind)
