"""The local server: who may ask it, what it refuses, episodes that are shown, heard and saved."""

import base64
import contextlib
import http.client
import json
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette")

import uvicorn
from placed import world_file
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from jaxlangnav.cli import main as cli
from jaxlangnav.grounding import load_shipped
from jaxlangnav.serve import server
from jaxlangnav.serve.live import LiveEpisode, Request
from jaxlangnav.world.files import load_world

TOKEN = "a-token"
TWO_HYDRANTS = world_file(
    (-2.0, 10.0, -5.0, 5.0), ("hydrant", 4.0, 2.0), ("hydrant", 4.0, -2.5), sensor={"range": 8.0}
)
AWAY = world_file((-2.0, 30.0, -10.0, 10.0), ("hydrant", 28.0, 8.0))


class Client:
    """A page's requests without a browser."""

    def __init__(self, port: int) -> None:
        self.port, self.own = port, f"http://127.0.0.1:{port}"

    def ask(
        self, path: str, body: Any = None, headers: dict[str, str] | None = None
    ) -> tuple[int, str]:
        line = http.client.HTTPConnection("127.0.0.1", self.port, timeout=120)
        with contextlib.closing(line):
            given = {"X-Token": TOKEN} if headers is None else headers
            content = body if isinstance(body, str | bytes | None) else json.dumps(body)
            line.request("GET" if body is None else "POST", path, content, given)
            answer = line.getresponse()
            return answer.status, answer.read().decode()

    def open(self, text: str, **options: Any) -> str:
        code, answer = self.ask("/episodes", {"text": text, **options})
        assert code == 200, answer
        return json.loads(answer)["name"]

    def watch(self, name: str, *, token: str = TOKEN, origin: str = "") -> ClientConnection:
        address = f"ws://127.0.0.1:{self.port}/episodes/{name}/live?token={token}"
        return connect(address, origin=origin or self.own, max_size=None)  # type: ignore[arg-type]


def until(line: ClientConnection, is_it: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Read news until some fit."""
    end = time.monotonic() + 120.0
    while time.monotonic() < end:
        news = json.loads(line.recv(timeout=120))
        if is_it(news):
            return news
    raise AssertionError("the news never came")


def is_resting(news: dict[str, Any]) -> bool:
    return bool(news.get("is_resting"))


@pytest.fixture(scope="module")
def served() -> Iterator[tuple[Client, server.Server]]:
    import socket

    listener = socket.socket()
    listener.bind(("127.0.0.1", 0))
    port = listener.getsockname()[1]
    with server.serving(load_shipped(), token=TOKEN, port=port, pace=0.0) as (app, ours):
        options: dict[str, Any] = {"log_level": "warning", "ws_max_size": server.MAX_MESSAGE_SIZE}
        runner = uvicorn.Server(uvicorn.Config(app, timeout_graceful_shutdown=1, **options))
        thread = threading.Thread(target=runner.run, kwargs={"sockets": [listener]})
        thread.start()
        while not runner.started:
            time.sleep(0.01)
        yield Client(port), ours
        runner.should_exit = True
        thread.join()


@pytest.fixture
def client(served: tuple[Client, server.Server]) -> Client:
    return served[0]


def test_the_page_asks_nothing_from_outside(client: Client) -> None:
    code, page = client.ask(f"/?token={TOKEN}", headers={})
    assert code == 200
    assert "connect-src 'self'" in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "https://" not in page
    assert "__" not in page


@pytest.mark.parametrize(
    ("headers", "why"),
    [
        ({}, "the token is missing or wrong"),
        ({"X-Token": "another"}, "the token is missing or wrong"),
        ({"X-Token": "töken"}, "the token is missing or wrong"),
        ({"X-Token": TOKEN, "Origin": "http://elsewhere.example"}, "from another page"),
        ({"X-Token": TOKEN, "Origin": "null"}, "from another page"),
        ({"X-Token": TOKEN, "Host": "elsewhere.example"}, "answers to 127.0.0.1 and localhost"),
    ],
)
@pytest.mark.parametrize("path", ["/", "/episodes", "/episodes/x/world.toml"])
def test_what_is_not_ours_is_refused(
    client: Client, headers: dict[str, str], why: str, path: str
) -> None:
    body = {"text": "go"} if path == "/episodes" else None
    code, answer = client.ask(path, body, headers)
    assert code == 403
    assert why in answer
    assert answer.count("\n") == 1


@pytest.mark.parametrize(("token", "origin"), [("wrong", ""), (TOKEN, "http://elsewhere.example")])
def test_a_socket_of_another_page_is_refused(client: Client, token: str, origin: str) -> None:
    with pytest.raises(InvalidStatus, match="403"):
        client.watch("any", token=token, origin=origin)


@pytest.mark.parametrize(
    ("document", "why"),
    [
        ({}, "text is missing"),
        ({"text": " "}, "text is ' '"),
        ({"text": "go", "speed": 3}, "speed is unknown"),
        ({"text": "x" * 1001}, "text has 1001 characters, but must have at most 1000"),
        ({"text": "go to the hydrant", "seed": -1}, "seed is -1, but must be a whole number"),
        ({"text": "go to the hydrant", "world": "/etc/passwd"}, "but must be one of: 1H1C"),
        ({"text": "go to the hydrant", "world": "yard.toml"}, 'did you mean "yard"?'),
        ({"text": "go to the hydrant", "document": "area = 3"}, "your world: area is 3"),
        ({"text": "go to the hydrant", "document": "{]"}, "your world:"),
        ({"text": "go to the hydrant", "range": 0}, "range is 0, but must be a number, at least"),
        ({"text": "flibbertigibbet"}, "flibbertigibbet"),
        ({"text": "go to the car", "world": "1H1C"}, "world 1H1C has no car"),
        ("no JSON", "Expecting value"),
        ("[" * 100_000, "nested too deeply"),
        ("x" * (server.MAX_BODY_SIZE + 1), "the most there may be: send less"),
    ],
)
def test_bad_input_gets_one_line(client: Client, document: Any, why: str) -> None:
    code, answer = client.ask("/episodes", document)
    line = json.loads(answer)["refusal"]
    assert code == 400
    assert why in line
    assert "\n" not in line


def test_a_world_file_is_read_for_the_plan(client: Client) -> None:
    code, answer = client.ask("/world", TWO_HYDRANTS)
    table = json.loads(answer)
    assert code == 200
    assert [one["x"] for one in table["objects"]] == [4.0, 4.0]
    assert table["sensor"]["range"] == 8.0
    assert client.ask("/world", json.dumps(table)) == (200, answer)
    code, answer = client.ask("/world", "[area]\nx_min = 'a'")
    assert (code, json.loads(answer)["refusal"][:31]) == (400, "your world: area.x_min is 'a', ")


def test_an_episode_is_shown_to_its_end_and_saved(client: Client, tmp_path: Path) -> None:
    name = client.open("go to the\thydrant behind the cone", seed=3)
    with client.watch(name) as line:
        first = until(line, lambda news: news["episode"] is not None)
        last = until(line, is_resting)
    assert first["episode"]["outcome"] in ("under way", "success")
    assert last["episode"]["outcome"] == "success"
    assert last["episode"]["closing"]
    (tmp_path / "world.toml").write_text(client.ask(f"/episodes/{name}/world.toml")[1])
    world = load_world(tmp_path / "world.toml")
    truth = last["episode"]["truth"]
    assert world.scenario.object_x[: len(truth)].tolist() == pytest.approx(
        [one["x"] for one in truth]
    )
    assert world.instruction == "go to the hydrant behind the cone"
    code, page = client.ask(f"/episodes/{name}/episode.html")
    assert code == 200
    assert '"outcome":"success"' in page
    assert "connect-src" not in page


def test_a_question_is_answered(client: Client) -> None:
    name = client.open("go to the hydrant", document=TWO_HYDRANTS)
    with client.watch(name) as line:
        asked = until(line, lambda news: bool(news.get("question")))
        assert [one["say"] for one in asked["question"]] == ["the first", "the second"]
        assert [one["thing"][:12] for one in asked["question"]] == ["the hydrant "] * 2
        line.send(json.dumps({"say": asked["question"][1]["say"]}))
        there = until(line, lambda news: is_resting(news) and bool(news["heard"]))
        assert there["heard"] == [{"text": "the second", "kind": "answer", "refusal": ""}]
        assert reached(there)[1] == pytest.approx(-2.5, abs=1.5)


def test_a_robot_that_has_arrived_is_sent_to_the_other_one(client: Client) -> None:
    name = client.open("go to the hydrant", document=TWO_HYDRANTS, may_ask=False)
    with client.watch(name) as line:
        first = until(line, is_resting)
        assert first["heard"] == []
        line.send(json.dumps({"say": "no, the other one"}))
        other = until(line, lambda news: is_resting(news) and len(news["heard"]) == 1)
        assert other["heard"][0]["kind"] == "correction"
        assert abs(reached(first)[1] - reached(other)[1]) > 2.0


def reached(news: dict[str, Any]) -> tuple[float, float]:
    """Where the robot stands, as the page reads it."""
    place = np.frombuffer(base64.b64decode(news["episode"]["arrays"]["position"]["data"]), "<f4")
    return float(place[-2]), float(place[-1])


def test_stop_halts_and_what_is_not_understood_is_told(client: Client) -> None:
    name = client.open("go to the hydrant", document=AWAY)
    with client.watch(name) as line:
        until(line, lambda news: news["episode"] is not None)
        line.send(json.dumps({"say": "stop"}))
        halted = until(line, is_resting)
        assert halted["episode"]["outcome"] == "halted"
        line.send(json.dumps({"say": "flibbertigibbet"}))
        told = until(line, lambda news: len(news["heard"]) == 2)
        assert told["heard"][1]["refusal"]
        for message, why in (
            ({"say": " "}, "nothing is said"),
            ({"say": "x" * 1001}, "1001 characters are said"),
            ({"say": 3}, "say is 3"),
            ("no JSON", "Expecting value"),
            ("[" * 5000, "recursion"),
        ):
            line.send(message if isinstance(message, str) else json.dumps(message))
            assert why in until(line, lambda news: "refusal" in news)["refusal"]
        line.send("x" * (server.MAX_MESSAGE_SIZE + 1))
        with pytest.raises(ConnectionClosed):
            until(line, lambda news: False)


def test_a_closed_socket_leaves_the_episode_going_for_the_next(client: Client) -> None:
    name = client.open("go to the hydrant behind the cone", seed=5)
    with client.watch(name) as line:
        until(line, lambda news: news["episode"] is not None)
    with client.watch(name) as again, client.watch(name) as beside:
        one, other = until(again, is_resting), until(beside, is_resting)
    assert one["episode"]["num_steps"] == other["episode"]["num_steps"] > 1


def test_two_episodes_go_on_at_once_and_do_not_hear_each_other(client: Client) -> None:
    names = [client.open("go to the hydrant", document=AWAY) for _ in range(2)]
    with client.watch(names[0]) as first, client.watch(names[1]) as second:
        first.send(json.dumps({"say": "stop"}))
        until(first, is_resting)
        second.send(json.dumps({"close": True}))
        over = until(second, lambda news: news["is_over"])
        assert over["heard"] == []
        second.send(json.dumps({"say": "go on"}))
        assert "has ended" in until(second, lambda news: "refusal" in news)["refusal"]


def test_the_oldest_episode_is_dropped_for_a_new_one(client: Client) -> None:
    names = [client.open("go to the hydrant", max_steps=1) for _ in range(server.MAX_EPISODES + 1)]
    assert client.ask(f"/episodes/{names[0]}/world.toml")[0] == 404
    assert client.ask(f"/episodes/{names[1]}/world.toml")[0] == 200
    with client.watch(names[0]) as line, pytest.raises(ConnectionClosed, match="not kept"):
        line.recv()


def test_a_fault_of_ours_is_told_and_the_server_goes_on(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*args: Any, **options: Any) -> Iterator[Any]:
        raise RuntimeError("out of\nluck")
        yield

    with monkeypatch.context() as patch:
        patch.setattr("jaxlangnav.episode.recorder.play", fail)
        name = client.open("go to the hydrant")
        with client.watch(name) as line:
            news = until(line, lambda news: news["is_over"])
    assert news["fault"] == "out of luck"
    assert client.ask(f"/episodes/{name}/world.toml")[0] == 200


def test_utterances_wait_in_a_short_queue(tmp_path: Path) -> None:
    asked = Request(text="go to the hydrant")
    one = LiveEpisode(asked, model=load_shipped(), folder=tmp_path, pace=0.0)
    for _ in range(8):
        one.say("go on")
    with pytest.raises(ValueError, match="still unheard"):
        one.say("go on")
    one.close()  # a full queue does not keep it from ending


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--port", "70000"], "--port is 70000, but must lie between 0 and 65535"),
        (["--pace", "-1"], "--pace is -1, but must lie between 0 and 60: give seconds"),
    ],
)
def test_the_command_refuses_what_cannot_be(
    options: list[str], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["serve", *options]) == 2
    assert why in capsys.readouterr().err


def test_a_port_that_is_taken_is_refused(
    client: Client, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["serve", "--port", str(client.port)]) == 2
    assert f"--port is {client.port}, but cannot be taken" in capsys.readouterr().err
