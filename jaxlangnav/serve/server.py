"""Local web server: the page, its episodes as JSON, and a WebSocket for state and utterances.

It listens on the loopback interface only. Every request must name this server as its host, carry
the token printed at the start, and, if it has an ``Origin`` header, come from this page: no
other page of the same browser can start, read or speak to an episode.
"""

import asyncio
import contextlib
import json
import secrets
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from importlib import resources
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, QueryParams
from starlette.middleware import Middleware
from starlette.requests import Request as HttpRequest
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from jaxlangnav.grounding import GroundingModel
from jaxlangnav.inputs.sanitize import sanitize
from jaxlangnav.inputs.schema import convert
from jaxlangnav.serve.live import LiveEpisode, Message, Request, read_world, world_names
from jaxlangnav.viz.html import fill_page, page_json, render_html
from jaxlangnav.world.files import MAX_FILE_BYTES

MAX_BODY_SIZE = 2 * MAX_FILE_BYTES  # bytes of a request: an escaped world file
MAX_MESSAGE_SIZE = 8 * 1024  # bytes of a WebSocket message
MAX_EPISODES = 8  # open at once; the oldest is closed for a new one
_POLL_SECONDS = 0.5  # interval of checks that the page is still connected
_HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


class Guard:
    """Middleware that rejects requests with a wrong host, origin or token."""

    def __init__(self, app: ASGIApp, *, token: str, port: int) -> None:
        """Wrap an application that is served on a port of the loopback interface."""
        self._app, self._token = app, token
        self._hosts = {f"{host}:{port}" for host in ("127.0.0.1", "localhost")}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Forward a valid request, or reject it."""
        reason = "" if scope["type"] == "lifespan" else self._reject_reason(scope)
        if not reason:
            return await self._app(scope, receive, send)
        if scope["type"] == "websocket":
            return await WebSocket(scope, receive, send).close(1008, reason)
        return await PlainTextResponse(reason + "\n", 403, _HEADERS)(scope, receive, send)

    def _reject_reason(self, scope: Scope) -> str:
        """Return why a request is rejected, or ""."""
        headers = Headers(scope=scope)
        if headers.get("host") not in self._hosts:
            return "this server answers to 127.0.0.1 and localhost only: open the printed address"
        origin = headers.get("origin")
        origins = {f"http://{host}" for host in self._hosts}
        if origin not in origins and (origin is not None or scope["type"] == "websocket"):
            return "the request comes from another page: open the printed address"
        token = headers.get("x-token") or QueryParams(scope["query_string"]).get("token", "")
        if not secrets.compare_digest(token.encode(), self._token.encode()):
            return "the token is missing or wrong: open the address that the server has printed"
        return ""


Endpoint = Callable[["Server", HttpRequest], Awaitable[Response]]


def _refusing(endpoint: Endpoint) -> Endpoint:
    """Answer a request for which the endpoint raises a ``ValueError`` by 400 and the reason."""

    async def respond(server: "Server", request: HttpRequest) -> Response:
        try:
            return await endpoint(server, request)
        except RecursionError:
            reason = "the document is nested too deeply: make it flat"
        except ValueError as error:
            reason = sanitize(" ".join(str(error).split()))
        return _json_response({"refusal": reason}, 400)

    return respond


class Server:
    """Registry of the open episodes, and the HTTP routes to them."""

    def __init__(self, model: GroundingModel, folder: Path, *, pace: float) -> None:
        """Create a server for trained models; sent worlds are stored in ``folder``."""
        self._model, self._folder, self._pace = model, folder, pace
        self._episodes: dict[str, LiveEpisode] = {}
        self.num_opened = 0

    def routes(self) -> list[Route | WebSocketRoute]:
        """List the routes."""
        prefix = "/episodes/{name}"
        return [
            Route("/", self._page),
            Route("/world", self._read_world, methods=["POST"]),
            Route("/episodes", self._open, methods=["POST"]),
            Route(f"{prefix}/world.toml", self._world),
            Route(f"{prefix}/episode.html", self._recording),
            WebSocketRoute(f"{prefix}/live", self._live),
        ]

    def warm_up(self) -> None:
        """Compile the programs for template worlds by one step of an episode."""
        request = Request(text="go to the hydrant behind the cone", max_steps=1)
        episode = LiveEpisode(request, model=self._model, folder=self._folder, pace=0.0)
        episode.close()
        episode.run()
        if episode.fault:
            raise RuntimeError(episode.fault)

    def close(self) -> None:
        """End every episode."""
        for episode in self._episodes.values():
            episode.close()

    async def _page(self, request: HttpRequest) -> Response:
        controls = resources.files("jaxlangnav.serve") / "controls.html"
        options = "".join(f"<option>{name}</option>" for name in world_names())
        html = controls.read_text(encoding="utf-8").replace("__WORLDS__", options)
        page = fill_page("jaxlangnav", None, controls=html, connect="'self'")
        return HTMLResponse(page, headers=_HEADERS)

    @_refusing
    async def _read_world(self, request: HttpRequest) -> Response:
        """Parse a world file for the page's map editor."""
        text = (await _read_body(request, MAX_FILE_BYTES)).decode(errors="replace")
        return _json_response(await run_in_threadpool(read_world, text))

    @_refusing
    async def _open(self, request: HttpRequest) -> Response:
        """Create and start an episode."""
        query = convert(json.loads(await _read_body(request, MAX_BODY_SIZE)), Request)
        name = secrets.token_hex(8)
        settings = {"model": self._model, "folder": self._folder / name, "pace": self._pace}
        episode = await run_in_threadpool(LiveEpisode, query, **settings)
        while len(self._episodes) >= MAX_EPISODES:
            self._episodes.pop(next(iter(self._episodes))).close()
        self._episodes[name] = episode
        self.num_opened += 1
        episode.start()
        return _json_response({"name": name})

    async def _world(self, request: HttpRequest) -> Response:
        episode = self._episodes.get(request.path_params["name"])
        if episode is None:
            return _not_found()
        return _file_response(episode.world(), "world.toml", "application/toml")

    async def _recording(self, request: HttpRequest) -> Response:
        episode = self._episodes.get(request.path_params["name"])
        recording = None if episode is None else await run_in_threadpool(episode.recording)
        if recording is None:
            return _not_found()
        page = await run_in_threadpool(render_html, recording)
        return _file_response(page, "episode.html", "text/html")

    async def _live(self, socket: WebSocket) -> None:
        """Stream the state of an episode to the page, and pass on its utterances."""
        episode = self._episodes.get(socket.path_params["name"])
        await socket.accept()
        if episode is None:
            await socket.close(1008, "this episode is not kept any more")
            return
        listener = asyncio.create_task(_listen(socket, episode))
        try:
            version = -1
            while not listener.done():
                newest = await run_in_threadpool(episode.wait, version, _POLL_SECONDS)
                if newest > version:
                    version = newest
                    is_over = episode.is_over
                    text = await run_in_threadpool(lambda: page_json(episode.describe()))
                    await socket.send_text(text)
                    if is_over:
                        # No more states follow, but utterances still get an answer.
                        await listener
        except (WebSocketDisconnect, RuntimeError):
            pass  # the page was closed; the episode goes on
        finally:
            listener.cancel()
            if socket.client_state == WebSocketState.CONNECTED:
                with contextlib.suppress(RuntimeError):
                    await socket.close()


async def _listen(socket: WebSocket, episode: LiveEpisode) -> None:
    """Receive messages of a page until it is closed."""
    with contextlib.suppress(WebSocketDisconnect):
        while True:
            try:
                message = convert(json.loads(await socket.receive_text()), Message)
                if message.close:
                    episode.close()
                else:
                    episode.say(message.say)
            except (ValueError, RecursionError) as error:
                await socket.send_text(page_json({"refusal": sanitize(str(error))}))


async def _read_body(request: HttpRequest, limit: int) -> bytes:
    """Read the request body; ``ValueError`` as soon as it exceeds a limit in bytes."""
    content = bytearray()
    async for chunk in request.stream():
        content += chunk
        if len(content) > limit:
            raise ValueError(
                f"more than {limit:,} bytes were sent, the most there may be: send less"
            )
    return bytes(content)


def _json_response(document: Any, code: int = 200) -> Response:
    return Response(page_json(document), code, _HEADERS, "application/json")


def _not_found() -> Response:
    return PlainTextResponse("this episode is not kept any more: press go\n", 404, _HEADERS)


def _file_response(content: str, name: str, media_type: str) -> Response:
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return Response(content, headers=_HEADERS | headers, media_type=media_type)


@contextlib.contextmanager
def serving(
    model: GroundingModel, *, token: str, port: int, pace: float
) -> Iterator[tuple[Starlette, Server]]:
    """Create the application for a port of the loopback; its files are removed at the end.

    Every request must carry the ``token``; a step takes at least ``pace`` seconds.
    """
    with tempfile.TemporaryDirectory(prefix="jaxlangnav-") as folder:
        server = Server(model, Path(folder), pace=pace)

        @contextlib.asynccontextmanager
        async def lifespan(app: Starlette) -> AsyncIterator[None]:
            yield
            server.close()

        guard = Middleware(Guard, token=token, port=port)
        yield Starlette(routes=server.routes(), middleware=[guard], lifespan=lifespan), server
