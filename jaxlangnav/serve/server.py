"""The local server: one page, its episodes as JSON, and a WebSocket that shows and hears.

It listens on the loopback only. Every request must name this server as its host, carry the token
that is printed at the start, and, where a browser says from which page it comes, come from ours:
no other page of the same browser can start, read or speak to an episode.
"""

import asyncio
import contextlib
import json
import secrets
import tempfile
from collections.abc import AsyncIterator, Callable, Iterator
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
from jaxlangnav.inputs.whole_files import read_file
from jaxlangnav.serve.live import LiveEpisode, Message, Request, places, read_world, warm_up
from jaxlangnav.viz.html import fill_page, page_json, write_html
from jaxlangnav.world.files import LARGEST_WORLD_FILE

LARGEST_BODY = 2 * LARGEST_WORLD_FILE  # bytes of a request: a world file, escaped
LARGEST_MESSAGE = 8 * 1024  # bytes of an utterance
MOST_EPISODES = 8  # that are kept: the oldest is closed for a new one
_LARGEST_RECORDING = 1 << 30
_POLL = 0.5  # seconds after which a wait for news looks whether the page is still there
_HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


class Guard:
    """Refuses what does not come from our own page: host, origin and token."""

    def __init__(self, app: ASGIApp, *, token: str, port: int) -> None:
        """Guard an application that is served on a port of the loopback."""
        self._app, self._token = app, token
        self._hosts = {f"{host}:{port}" for host in ("127.0.0.1", "localhost")}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on what is ours."""
        if scope["type"] == "lifespan":
            return await self._app(scope, receive, send)
        fault = self._fault(scope)
        if not fault:
            return await self._app(scope, receive, send)
        if scope["type"] == "websocket":
            return await WebSocket(scope, receive, send).close(1008, fault)
        return await PlainTextResponse(fault + "\n", 403, _HEADERS)(scope, receive, send)

    def _fault(self, scope: Scope) -> str:
        """Say why a request is refused; empty where it is not."""
        headers = Headers(scope=scope)
        if headers.get("host") not in self._hosts:
            return "this server answers to 127.0.0.1 and localhost only: open the printed address"
        origin = headers.get("origin")
        own = {f"http://{host}" for host in self._hosts}
        if origin not in own and (origin is not None or scope["type"] == "websocket"):
            return "the request comes from another page: open the printed address"
        token = headers.get("x-token") or QueryParams(scope["query_string"]).get("token", "")
        if not secrets.compare_digest(token.encode(), self._token.encode()):
            return "the token is missing or wrong: open the address that the server has printed"
        return ""


class Server:
    """The episodes of one process, and the routes that lead to them."""

    def __init__(self, model: GroundingModel, folder: Path, *, pace: float) -> None:
        """Serve trained models; worlds that are sent lie in a folder while they are in use."""
        self._model, self._folder, self._pace = model, folder, pace
        self._episodes: dict[str, LiveEpisode] = {}
        self.num_opened = 0

    def routes(self) -> list[Route | WebSocketRoute]:
        """List the routes."""
        one = "/episodes/{name}"
        return [
            Route("/", self._page),
            Route("/world", self._read_world, methods=["POST"]),
            Route("/episodes", self._open, methods=["POST"]),
            Route(f"{one}/world.toml", self._world),
            Route(f"{one}/episode.html", self._recording),
            WebSocketRoute(f"{one}/live", self._live),
        ]

    def warm_up(self) -> None:
        """Compile ahead of the first sentence."""
        warm_up(self._model, self._folder)

    def close(self) -> None:
        """End every episode."""
        for episode in self._episodes.values():
            episode.close()

    async def _page(self, request: HttpRequest) -> Response:
        controls = resources.files("jaxlangnav.serve") / "controls.html"
        options = "".join(f"<option>{name}</option>" for name in places())
        filled = controls.read_text(encoding="utf-8").replace("__WORLDS__", options)
        page = fill_page("jaxlangnav", None, controls=filled, connect="'self'")
        return HTMLResponse(page, headers=_HEADERS)

    async def _read_world(self, request: HttpRequest) -> Response:
        """Read a world file for the page that draws it."""
        with _refusals() as refusal:
            text = (await _body(request, LARGEST_WORLD_FILE)).decode(errors="replace")
            return _answer(await run_in_threadpool(read_world, text))
        return refusal()

    async def _open(self, request: HttpRequest) -> Response:
        """Open an episode and start it."""
        with _refusals() as refusal:
            document = json.loads(await _body(request, LARGEST_BODY))
            return _answer({"name": await run_in_threadpool(self._start, document)})
        return refusal()

    def _start(self, document: Any) -> str:
        asked = convert(document, Request)
        name = secrets.token_hex(8)
        episode = LiveEpisode(asked, model=self._model, folder=self._folder / name, pace=self._pace)
        for oldest in list(self._episodes)[: max(0, len(self._episodes) + 1 - MOST_EPISODES)]:
            self._episodes.pop(oldest).close()
        self._episodes[name] = episode
        self.num_opened += 1
        episode.start()
        return name

    async def _world(self, request: HttpRequest) -> Response:
        episode = self._episodes.get(request.path_params["name"])
        if episode is None:
            return _gone()
        return _file(episode.world().encode(), "world.toml", "application/toml")

    async def _recording(self, request: HttpRequest) -> Response:
        episode = self._episodes.get(request.path_params["name"])
        recording = None if episode is None else await run_in_threadpool(episode.recording)
        if recording is None:
            return _gone()
        path = self._folder / f"{secrets.token_hex(8)}.html"
        await run_in_threadpool(write_html, recording, path)
        content = read_file(path, at_most=_LARGEST_RECORDING)
        path.unlink()
        return _file(content, "episode.html", "text/html")

    async def _live(self, socket: WebSocket) -> None:
        """Show an episode as it grows, and hear what is said to it."""
        episode = self._episodes.get(socket.path_params["name"])
        await socket.accept()
        if episode is None:
            await socket.close(1008, "this episode is not kept any more")
            return
        listening = asyncio.create_task(_listen(socket, episode))
        try:
            version = -1
            while not listening.done():
                newest = await run_in_threadpool(episode.wait, version, _POLL)
                if newest > version:
                    version = newest
                    is_over = episode.is_over
                    text = await run_in_threadpool(lambda: page_json(episode.describe()))
                    await socket.send_text(text)
                    if is_over:
                        # Nothing more comes, but what is said is still answered.
                        await listening
        except (WebSocketDisconnect, RuntimeError):
            pass  # the page has gone; the episode goes on and can be looked at again
        finally:
            listening.cancel()
            if socket.client_state == WebSocketState.CONNECTED:
                with contextlib.suppress(RuntimeError):
                    await socket.close()


async def _listen(socket: WebSocket, episode: LiveEpisode) -> None:
    """Take in what a page says until it is closed."""
    with contextlib.suppress(WebSocketDisconnect):
        while True:
            text = await socket.receive_text()
            try:
                message = convert(json.loads(text), Message)
                if message.close:
                    episode.close()
                else:
                    episode.say(message.say)
            except ValueError as error:
                await socket.send_text(page_json({"refusal": sanitize(str(error))}))


@contextlib.contextmanager
def _refusals() -> Iterator[Callable[[], Response]]:
    """Turn a ``ValueError`` into an answer of one line, which is what is yielded then gives."""
    line: list[str] = []
    try:
        yield lambda: _answer({"refusal": line[0]}, 400)
    except RecursionError:
        line.append("the document is nested too deeply: make it flat")
    except ValueError as error:
        line.append(sanitize(" ".join(str(error).split())))


async def _body(request: HttpRequest, most: int) -> bytes:
    """Read what was sent, or refuse it as soon as it is too large."""
    content = bytearray()
    async for piece in request.stream():
        content += piece
        if len(content) > most:
            raise ValueError(
                f"more than {most:,} bytes were sent, the most there may be: send less"
            )
    return bytes(content)


def _answer(document: Any, code: int = 200) -> Response:
    return Response(page_json(document), code, _HEADERS, "application/json")


def _gone() -> Response:
    return PlainTextResponse("this episode is not kept any more: press go\n", 404, _HEADERS)


def _file(content: bytes, name: str, kind: str) -> Response:
    saved = {"Content-Disposition": f'attachment; filename="{name}"'}
    return Response(content, headers=_HEADERS | saved, media_type=kind)


@contextlib.contextmanager
def serving(
    model: GroundingModel, *, token: str, port: int, pace: float
) -> Iterator[tuple[Starlette, Server]]:
    """Make the application for a port of the loopback; its files are removed at the end.

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
