"""The page of ``jaxlangnav serve`` in a real browser; skips where there is none."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from test_serve import TWO_HYDRANTS

sync = pytest.importorskip("playwright.sync_api", reason="needs the extra browser")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
if CHROMIUM is None:
    pytest.skip("needs Chromium on the path", allow_module_level=True)

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::ResourceWarning")]
SCREENSHOTS = os.environ.get("JAXLANGNAV_SCREENSHOTS")
LONG = 180_000  # milliseconds: a cold engine compiles, on a busy machine too
FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    command = [sys.executable, "-m", "jaxlangnav", "serve", "--port", "0", "--pace", "0.1"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    said = ""
    while "ready" not in said:
        line = process.stderr.readline()
        assert line, said
        said += line
    found = re.search(r"http://\S+", said)
    assert found is not None
    yield found[0]
    process.terminate()
    process.wait(20)


@pytest.fixture(scope="module")
def browser() -> Iterator["sync.Browser"]:
    with sync.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield opened
        opened.close()


@pytest.fixture
def page(browser: "sync.Browser", address: str) -> Iterator["sync.Page"]:
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    one = context.new_page()
    faults: list[str] = []
    one.on("pageerror", lambda error: faults.append(str(error)))
    one.goto(address)
    one.wait_for_selector("body[data-controls=ready]")
    yield one
    context.close()
    assert faults == []


def keep(page: "sync.Page", name: str) -> None:
    if SCREENSHOTS:
        page.screenshot(path=Path(SCREENSHOTS) / f"{name}.png", full_page=True)


def go(page: "sync.Page", text: str) -> None:
    page.fill("#text", text)
    page.click("#go")


def wait_for_state(page: "sync.Page", state: str) -> None:
    page.wait_for_selector(f"body[data-state={state}]", timeout=LONG)


def test_type_watch_and_arrive(page: "sync.Page") -> None:
    go(page, "go to the hydrant behind the cone")
    page.wait_for_selector("body[data-state=going]", timeout=LONG)
    assert page.inner_text("#verdict") == "under way"
    wait_for_state(page, "resting")
    assert page.inner_text("#verdict") == "success"
    assert int(page.get_attribute("body", "data-ready") or 0) > 1
    assert "Says stop" in page.inner_text("#story")
    keep(page, "arrived")
    with page.expect_download() as world:
        page.click("#save_world")
    assert "[[objects]]" in Path(world.value.path()).read_text()
    with page.expect_download() as episode:
        page.click("#save_episode")
    assert '"outcome":"success"' in Path(episode.value.path()).read_text()


def test_stop_halts_at_once(page: "sync.Page") -> None:
    page.select_option("#world", "street")
    go(page, "go to the hydrant")
    wait_for_state(page, "going")
    page.click("#stop")
    wait_for_state(page, "resting")
    assert page.inner_text("#verdict") == "halted"
    assert "“stop”" in page.inner_text("#heard")


def test_a_dropped_world_and_a_question_answered_by_a_click(page: "sync.Page") -> None:
    files = [{"name": "two.toml", "mimeType": "application/toml", "buffer": TWO_HYDRANTS.encode()}]
    page.set_input_files("#file", files=files)  # type: ignore[arg-type]
    page.wait_for_selector("#editor:not([hidden])")
    go(page, "go to the hydrant")
    wait_for_state(page, "asking")
    keep(page, "asking")
    page.click("#question button:nth-of-type(2)")
    page.wait_for_selector("#heard li", timeout=LONG)
    wait_for_state(page, "resting")
    assert "taken as answer" in page.inner_text("#heard")


def test_the_robot_is_corrected_where_it_has_arrived(page: "sync.Page") -> None:
    page.select_option("#world", "2H1C")
    page.uncheck("#may_ask")
    go(page, "go to the hydrant")
    wait_for_state(page, "resting")
    page.fill("#say", "no, the other one")
    page.press("#say", "Enter")
    page.wait_for_selector("#heard li", timeout=LONG)
    wait_for_state(page, "resting")
    assert "taken as correction" in page.inner_text("#heard")


def test_a_world_is_drawn_and_searched(page: "sync.Page") -> None:
    page.click("#draw")
    page.fill("#range", "8")
    page.fill("#kind", "mug")
    page.click("#plan", position={"x": 200, "y": 150})
    page.click("#wall")
    page.click("#plan", position={"x": 300, "y": 100})
    page.click("#plan", position={"x": 300, "y": 250})
    keep(page, "drawn")
    go(page, "go to the mug")
    wait_for_state(page, "resting")
    assert page.inner_text("#verdict") == "success"


def test_a_refusal_is_one_line(page: "sync.Page") -> None:
    go(page, "go to the car")
    page.wait_for_selector("#fault:not([hidden])", timeout=LONG)
    assert "world 1H1C has no car" in page.inner_text("#fault")
    go(page, "go to the hydrant")
    wait_for_state(page, "resting")
    assert page.is_hidden("#fault")


def test_a_reload_goes_on_where_it_was(page: "sync.Page") -> None:
    page.select_option("#world", "street")
    go(page, "find the car")
    wait_for_state(page, "going")
    page.reload()
    page.wait_for_selector("body[data-connected]", timeout=LONG)
    wait_for_state(page, "resting")
    assert page.inner_text("#title") == "“find the car”"


def test_two_tabs_have_episodes_of_their_own(
    page: "sync.Page", browser: "sync.Browser", address: str
) -> None:
    other = browser.new_page()
    other.goto(address)
    other.wait_for_selector("body[data-controls=ready]")
    page.select_option("#world", "street")
    go(page, "find the car")
    go(other, "go to the hydrant behind the cone")
    wait_for_state(page, "going")
    page.click("#stop")
    wait_for_state(page, "resting")
    wait_for_state(other, "resting")
    assert "stop" not in other.inner_text("#heard")
    other.close()


def test_a_lost_connection_is_told_and_mended(page: "sync.Page") -> None:
    sockets: list[sync.WebSocketRoute] = []

    def pass_on(route: "sync.WebSocketRoute") -> None:
        route.connect_to_server()
        sockets.append(route)

    page.route_web_socket("**/live*", pass_on)
    page.reload()
    page.wait_for_selector("body[data-controls=ready]")
    page.select_option("#world", "street")
    go(page, "find the car")
    wait_for_state(page, "going")
    sockets[0].close()
    page.wait_for_selector("#fault:has-text('the connection is lost')")
    page.wait_for_selector("body[data-connected]")
    wait_for_state(page, "resting")
    assert page.is_hidden("#fault")
    assert len(sockets) == 2


def test_nothing_covers_the_map_on_a_small_screen(page: "sync.Page") -> None:
    page.set_viewport_size({"width": 500, "height": 900})
    go(page, "go to the hydrant behind the cone")
    wait_for_state(page, "resting")
    keep(page, "small")
    canvas = page.locator("#map").bounding_box()
    layers = page.locator("#layers").bounding_box()
    assert canvas is not None
    assert layers is not None
    assert layers["y"] >= canvas["y"] + canvas["height"] - 1
    assert page.evaluate("document.documentElement.scrollWidth") <= 500
