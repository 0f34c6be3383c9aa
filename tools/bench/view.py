"""How quick the view is: pointer to bus, moves of a drag, frames a second with ten links.

Run ``python tools/bench/view.py``; results belong in docs/benchmarks.md. The bus is simulated, in
this process, at real speed; the browser is the system's Chromium without a window.
"""

from __future__ import annotations

import json
import os
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright
from websockets.sync.client import ClientConnection, connect

from ikservo.arm.streaming.beat import Beat
from ikservo.model import load_model
from ikservo.view.server.messages import Pointer
from ikservo.view.server.visitors import proof
from ikservo.view.session.house import House

EVENTS, MOVES, SECONDS = 300, 200, 5
BAR = '<origin xyz="0.03 0 0"/><geometry><box size="0.06 0.02 0.02"/></geometry>'
LINK = f"""  <link name="l{{i}}">
  <visual>{BAR}</visual>
  <collision>{BAR}</collision>
  </link>
"""
JOINT = """  <joint name="j{i}" type="revolute"><parent link="l{before}"/><child link="l{i}"/>
  <origin xyz="{x} 0 0"/><axis xyz="0 0 1"/>
  <limit lower="-2" upper="2" effort="1.5" velocity="6"/></joint>
"""
TIP = """  <link name="tool"/>
  <joint name="tip" type="fixed"><parent link="l{i}"/><child link="tool"/>
  <origin xyz="0.06 0 0"/></joint>
"""
SERVO = """[[joints]]
name = "j{i}"
role = "arm"
zero_from = "nominal"
servo = {{ id = {i}, model = "XL430-W250", sign = 1, zero_tick = 2048 }}
"""


class Page:
    """A page that is no browser: it says when it says something."""

    def __init__(self, socket: ClientConnection, key: str) -> None:
        self._socket, self._seq, self._seen = socket, 0, 0
        socket.send(json.dumps({"kind": "hello", "proof": proof(key, self.hear()["nonce"])}))
        self.say("look", w=900, h=700, dpr=1, view="side")

    def hear(self, timeout_s: float = 10.0) -> dict[str, Any]:
        """Return the next message."""
        message: dict[str, Any] = json.loads(self._socket.recv(timeout=timeout_s))
        if message["kind"] == "scene":
            self._seen = message["seq"]
        return message

    def say(self, kind: str, **fields: object) -> None:
        """Say something now."""
        self._seq += 1
        message = {"kind": kind, "seq": self._seq, "seen": self._seen, **fields}
        self._socket.send(json.dumps(message))

    def point(self, phase: str, x: float, y: float) -> None:
        """Say where the pointer is."""
        self.say("pointer", phase=phase, x=x, y=y, button=0, pointer=1)

    def live_for(self, seconds: float) -> None:
        """Hear scenes and beat, as a page does."""
        end_s = time.monotonic() + seconds
        while True:
            try:
                if self.hear(max(0.0, end_s - time.monotonic()))["kind"] == "scene":
                    self.say("beat", visible=True)
            except TimeoutError:
                return


@contextmanager
def served(arm: str, pose: str) -> Generator[tuple[House, Page]]:
    """Serve an arm and visit it with Live thrown."""
    house = House(load_model(arm), f"sim:?pose={pose}", dead_man_s=5.0)
    with ExitStack() as stack:
        urls = stack.enter_context(house)
        stack.enter_context(house.serve_beside())
        url = urls.control.partition("/#")[0]
        address = url.replace("http", "ws") + "/live"
        socket = stack.enter_context(connect(address, origin=url, proxy=None))  # pyright: ignore[reportArgumentType]
        page = Page(socket, house.keys.control)
        page.say("speed", name="fast")
        page.say("live", on=True)
        page.live_for(1.5)
        yield house, page


def latencies_ms() -> list[float]:
    """Return how long single pointer events take to the first goal on the bus that obeys them."""
    took: list[float] = []
    with served("so101", "home") as (house, page):
        out = _goal_times(house)
        page.point("down", 560, 250)
        for count in range(EVENTS):
            page.live_for(0.03)
            before = house.pilot.wish.goal
            said_s = time.perf_counter()
            page.point("move", 560 + 8 * (count % 7), 250 + 6 * (count % 5))
            took.append(1000 * (_obeyed_s(house, out, before, said_s) - said_s))
    return took


def _goal_times(house: House) -> list[tuple[float, object]]:
    """Return a list that grows by the time and the wish behind each goal that is sent."""
    out: list[tuple[float, object]] = []
    servos = house.pilot.arm.workings.servos
    send: Callable[[Any], None] = servos.command
    see = house.pilot.see
    taken: list[object] = [None]

    def seen(beat: Beat) -> None:  # a beat's wish is in the goals of the next
        see(beat)
        taken[:] = [house.pilot.wish.goal]

    house.pilot.see = seen

    def command(positions: Any) -> None:  # noqa: ANN401
        send(positions)
        out.append((time.perf_counter(), taken[-1]))

    servos.command = command
    return out


def _obeyed_s(
    house: House, out: list[tuple[float, object]], before: object, said_s: float
) -> float:
    deadline_s = said_s + 1.0
    while time.perf_counter() < deadline_s:
        for at_s, wish in out[-20:]:
            if at_s > said_s and wish is not before and wish is house.pilot.wish.goal:
                return at_s
        time.sleep(0.0005)
    return deadline_s


def drag() -> tuple[int, int]:
    """Return how many of the moves of a drag were heard, and by how many it lagged at most."""
    with served("so101", "home") as (house, page):
        heard: list[int] = []
        hear: Callable[..., None] = house.desk.receive
        said = 0

        def receive(visitor: int, message: Any) -> None:  # noqa: ANN401
            hear(visitor, message)
            if isinstance(message, Pointer) and message.phase == "move":
                heard.append(said - len(heard) - 1)

        house.desk.receive = receive
        page.point("down", 560, 250)
        for count in range(MOVES):
            said += 1
            page.point("move", 560 - count / 2, 250 + count / 4)
            page.live_for(1 / 60)
        page.live_for(0.5)
        return len(heard), max(heard)


def frames_per_second() -> float:
    """Return the frames that Chromium draws in a second while an arm of ten links is dragged."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        house = House(load_model(str(_ten_links(Path(folder)))), "sim", dead_man_s=5.0)
        urls = stack.enter_context(house)
        stack.enter_context(house.serve_beside())
        playwright = stack.enter_context(sync_playwright())
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        page = browser.new_page(viewport={"width": 1100, "height": 720})
        page.goto(urls.control)
        page.wait_for_selector("#views button")
        page.wait_for_timeout(1500)
        page.mouse.move(550, 350)
        page.mouse.down()
        page.evaluate(DRAW_ON)
        page.wait_for_timeout(1000 * SECONDS)
        drawn = page.evaluate("window.ikservo.drawn - window.drawnBefore")
        seconds = page.evaluate("(performance.now() - window.began) / 1000")
        browser.close()
        return drawn / seconds


# The pointer is moved inside the page at each frame: the test's own pipe is not what is measured.
DRAW_ON = """() => {
  const canvas = document.getElementById("drawing");
  window.drawnBefore = window.ikservo.drawn;
  window.began = performance.now();
  const move = (now) => {
    const box = canvas.getBoundingClientRect();
    canvas.dispatchEvent(new PointerEvent("pointermove", { pointerId: 1, clientX: box.x + 450 +
      200 * Math.cos(now / 400), clientY: box.y + 320 + 150 * Math.sin(now / 300) }));
    requestAnimationFrame(move);
  };
  requestAnimationFrame(move);
}"""


def _ten_links(folder: Path) -> Path:
    links = [LINK.format(i=i) for i in range(11)]
    joints = [JOINT.format(i=i, before=i - 1, x=0.0 if i == 1 else 0.06) for i in range(1, 11)]
    urdf = f'<robot name="ten">\n{"".join(links + joints)}{TIP.format(i=10)}</robot>\n'
    (folder / "arm.urdf").write_text(urdf, encoding="utf-8")
    head = (load_model("planar3").path).read_text(encoding="utf-8").partition("[[joints]]")[0]
    head = head.replace('"planar3"', '"ten"').replace("Three servos", "Ten servos")
    servos = "".join(SERVO.format(i=i) for i in range(1, 11))
    pose = ", ".join(f"j{i} = {12.0 if i > 1 else -50.0}" for i in range(1, 11))
    poses = "".join(f"[poses.{name}]\ndeg = {{ {pose} }}\n" for name in ("rest", "home", "zero"))
    path = folder / "arm.toml"
    path.write_text(head + servos + poses, encoding="utf-8")
    return path


def main() -> None:
    """Measure and print."""
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    took = sorted(latencies_ms())
    p95 = took[int(0.95 * len(took))]
    print(f"pointer to goal, {EVENTS} events: median {statistics.median(took):.1f} ms, "
          f"p95 {p95:.1f} ms, most {took[-1]:.1f} ms")  # fmt: skip
    heard, lag = drag()
    print(f"one drag of {MOVES} moves: {MOVES - heard} lost, at most {lag} behind")
    print(f"ten links, dragged: {frames_per_second():.0f} frames a second")


if __name__ == "__main__":
    main()
