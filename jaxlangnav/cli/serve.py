"""``jaxlangnav serve``: a local web page to talk to the robot while it searches."""

import contextlib
import dataclasses
import secrets
import socket
import threading
from typing import Any

from jaxlangnav.cli import checks
from jaxlangnav.cli.output import Document, Output, UsageError, one_line
from jaxlangnav.inputs.limits import bounded


@dataclasses.dataclass(frozen=True, kw_only=True)
class Serve:
    """Open a page on this machine: type a sentence, watch the belief grow, say more, answer.

    Pick, draw or drop a world, press go; what you type afterwards the robot hears before its next
    step. The page is served on the loopback only, and loads nothing from outside. Ctrl-C ends it.

    Examples:
      jaxlangnav serve
      jaxlangnav serve --port 9000 --pace 1 --open
    """

    port: int = 8765
    """Of the loopback; 0: any that is free."""
    pace: float = 0.3
    """Seconds that a step takes at least, so that you can follow."""
    open: bool = False
    """Open the page in your browser."""
    weights: checks.File = None
    """Trained models, written by jaxlangnav train; the shipped ones if not given."""
    json: bool = False
    """Print one JSON document at the end: address, episodes."""

    def run(self, output: Output) -> Document:
        """Serve until interrupted."""
        bounded(self.port, 0, 65535, "--port", "8765 is usual, 0 takes any that is free")
        bounded(self.pace, 0.0, 60.0, "--pace", "give seconds")
        for module in ("starlette", "uvicorn", "websockets"):
            checks.check_extra("serve needs a small web server", module, "serve")
        listener = self._listen()
        port = listener.getsockname()[1]
        token = secrets.token_urlsafe(16)
        address = f"http://127.0.0.1:{port}/?token={token}"

        import uvicorn

        from jaxlangnav.cli.runtime import keep_compiled_programs
        from jaxlangnav.grounding.weights import load
        from jaxlangnav.serve.server import MAX_MESSAGE_SIZE, serving

        keep_compiled_programs()
        with serving(load(self.weights), token=token, port=port, pace=self.pace) as (app, server):
            options: dict[str, Any] = {"log_level": "warning", "ws_max_size": MAX_MESSAGE_SIZE}
            options |= {"timeout_graceful_shutdown": 2, "server_header": False}
            output.note(f"jaxlangnav serves on this machine only: {address}")
            threading.Thread(target=self._prepare, args=(server, output), daemon=True).start()
            if self.open:
                import webbrowser

                webbrowser.open(address)
            # Ctrl-C is the normal way to stop.
            with listener, contextlib.suppress(KeyboardInterrupt):
                uvicorn.Server(uvicorn.Config(app, **options)).run(sockets=[listener])
        output.note(f"ended; episodes opened: {server.num_opened}")
        return {"address": address, "episodes": server.num_opened}

    def _listen(self) -> socket.socket:
        """Bind the port before heavy imports."""
        listener = socket.socket()
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind(("127.0.0.1", self.port))
        except OSError as error:
            listener.close()
            hint = "name another, or --port 0 for any that is free"
            raise UsageError(
                f"--port is {self.port}, but cannot be taken ({error.strerror}): {hint}"
            ) from None
        return listener

    def _prepare(self, server: Any, output: Output) -> None:
        """Compile the episode program ahead of the first sentence."""
        try:
            server.warm_up()
        except Exception as error:
            output.note(f"could not compile ahead: {one_line(error)}")
        else:
            output.note("ready: what is compiled serves every sentence")
