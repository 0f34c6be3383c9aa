"""Web page on which a person allows an agent's plans; only this machine can open the page."""

from __future__ import annotations

import hmac
import json
import secrets
import socket
import threading
from collections.abc import Awaitable, Callable, Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, cast

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route

from ikservo.apps.agent.agent_arm import AgentArm, quoted
from ikservo.apps.agent.plan_store import Answer
from ikservo.errors import IkservoError, InputError
from ikservo.files.reading import config_dir
from ikservo.files.writing import write_atomic

HOST = "127.0.0.1"
_PAGE = (Path(__file__).parent / "consent_page.html").read_text("utf-8")
_HEADERS = {
    "cache-control": "no-store",
    "referrer-policy": "no-referrer",
    "content-security-policy": "default-src 'none'; connect-src 'self'; img-src blob:; "
    "script-src 'unsafe-inline'; style-src 'unsafe-inline'; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'none'",
}
Handler = Callable[[Request], Awaitable[Response]]


@contextmanager
def consent_server(agent: AgentArm) -> Generator[str]:
    """Serve the page in a thread; yield its address, which contains the key.

    Raises:
        FileWriteError: The address cannot be stored for ``ikservo mcp --approve``.
    """
    key = secrets.token_urlsafe(24)
    listening = socket.create_server((HOST, 0))
    port = cast("int", listening.getsockname()[1])
    config = uvicorn.Config(_make_app(agent, key, port), log_config=None, access_log=False)
    server = uvicorn.Server(config)
    thread = threading.Thread(
        target=server.run, args=([listening],), name="consent page", daemon=True
    )
    address = f"http://{HOST}:{port}/#{key}"
    write_atomic(address_file(), json.dumps({"address": address}), private=True)
    thread.start()
    try:
        yield address
    finally:
        server.should_exit = True
        thread.join(2.0)
        with suppress(InputError):
            if stored_address() == address:  # unless a later server has replaced it
                address_file().unlink(missing_ok=True)


def address_file() -> Path:
    """Return the file with the address of the running server; only its owner can read it."""
    return config_dir() / "agent" / "consent.json"


def stored_address() -> str:
    """Return the address of the running server.

    Raises:
        InputError: No server is running.
    """
    try:
        return str(json.loads(address_file().read_text("utf-8"))["address"])
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError("No agent is connected.", "Start `ikservo mcp` first.") from None


def _make_app(agent: AgentArm, key: str, port: int) -> Starlette:
    """Return the application; every request needs the key, except the request for the page."""
    hosts = {f"{name}:{port}" for name in (HOST, "localhost")}

    def checked(handle: Handler, *, needs_key: bool = True) -> Handler:
        async def answer(request: Request) -> Response:
            origin = request.headers.get("origin")
            is_own = origin is None or origin.removeprefix("http://") in hosts
            if request.headers.get("host") not in hosts or not is_own:
                return PlainTextResponse("This page opens only on the machine that serves it.", 403)
            given = request.headers.get("authorization", "")
            if needs_key and not hmac.compare_digest(given.encode(), f"Bearer {key}".encode()):
                return PlainTextResponse("The key in the address is wrong.", 401)
            try:
                return await handle(request)
            except IkservoError as error:
                return PlainTextResponse(str(error), 409)

        return answer

    async def page(_: Request) -> Response:
        return HTMLResponse(_PAGE, headers=_HEADERS)

    async def plans(_: Request) -> Response:
        asked = [{"id": each.id, "summary": list(each.summary)} for each in agent.plans.asked()]
        stopped_for = quoted(agent.arm.stopped_for)
        return JSONResponse({"plans": asked, "stopped_for": stopped_for}, headers=_HEADERS)

    async def picture(request: Request) -> Response:
        return Response(agent.picture_of(request.path_params["plan"]), media_type="image/png")

    async def answer_plan(request: Request) -> Response:
        answer = Answer.YES if request.url.path.endswith("/yes") else Answer.NO
        plan = agent.plans.find(request.path_params["plan"])
        agent.journal.write("answered", plan=plan.id, answer=answer.value)
        agent.plans.answer(plan.id, answer, "a person")
        return Response(status_code=204)

    async def stop(_: Request) -> Response:
        agent.stop("with the button on the page", "A person")
        return Response(status_code=204)

    async def acknowledge(_: Request) -> Response:
        agent.acknowledge("a person")
        return Response(status_code=204)

    routes: list[tuple[str, str, Any]] = [
        ("GET", "/plans", plans),
        ("GET", "/plans/{plan}.png", picture),
        ("POST", "/plans/{plan}/yes", answer_plan),
        ("POST", "/plans/{plan}/no", answer_plan),
        ("POST", "/stop", stop),
        ("POST", "/acknowledge", acknowledge),
    ]
    return Starlette(
        routes=[
            Route("/", checked(page, needs_key=False)),
            *(Route(path, checked(handle), methods=[method]) for method, path, handle in routes),
        ]
    )
