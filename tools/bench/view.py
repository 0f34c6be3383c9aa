"""Measure the view: pointer to bus, moves of a drag, frames per second with ten links, traffic.

Run ``python tools/bench/view.py [PART ...]``; results belong in docs/benchmarks.md. The bus is
simulated, in this process, at real speed; the browser is the system's Chromium without a window.
"""

from __future__ import annotations

import argparse
import gzip
import math
import os
import shutil
import statistics
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import sync_playwright
from ten_links import ten_links
from visiting import Page, served

from ikservo.apps.page.messages.page_messages import Pointer
from ikservo.apps.page.page_app import ViewApp
from ikservo.apps.page.running import arm_thread as arm_thread_module
from ikservo.apps.page.served_arms import ArmAtPort, ServedArm
from ikservo.control.loop import ControlCycle
from ikservo.kinematics.arrays import Vector
from ikservo.model import load_model

EVENTS, ARRIVALS, MOVES, SECONDS = 300, 60, 200, 5
REFRESH_S = 1 / 60


def latencies_ms() -> list[float]:
    """Return the time from single pointer events to the first goal on the bus."""
    took: list[float] = []
    with served("so101", "home") as (house, page):
        out = _goal_times(house)
        grab(house, page, 560, 250)
        for count in range(EVENTS):
            page.live_for(0.03)
            before = house.arm_thread.command.goal
            said_s = time.perf_counter()
            page.point("move", 560 + 8 * (count % 7), 250 + 6 * (count % 5))
            took.append(1000 * (_obeyed_s(house, out, before, said_s) - said_s))
    return took


def grab(house: ServedArm, page: Page, x: float, y: float) -> None:
    """Press until the arm has a goal, because a busy machine may drop a message as too old.

    Raises:
        TimeoutError: The arm has no goal within half a minute.
    """
    deadline_s = time.monotonic() + 30.0
    while house.arm_thread.command.goal is None:
        if time.monotonic() > deadline_s:
            raise TimeoutError(f"no goal: {house.arm_thread.snapshot.stop_notice}")
        page.point("down", x, y)
        page.live_for(0.3)


def _goal_times(house: ServedArm) -> list[tuple[float, object]]:
    """Return a list that grows by the time and the command of each goal that is sent."""
    out: list[tuple[float, object]] = []
    servos = house.arm_thread.arm.context.servos
    send: Callable[[Vector, float], bool] = servos.send_goals
    on_cycle = house.arm_thread.on_cycle
    taken: list[object] = [None]

    def record(cycle: ControlCycle) -> None:  # a command is in the goals of the next cycle
        on_cycle(cycle)
        taken[:] = [house.arm_thread.command.goal]

    house.arm_thread.on_cycle = record

    def command(positions: Vector, now_s: float, reference: Vector | None = None) -> bool:
        sent = send(positions, now_s, reference)
        out.append((time.perf_counter(), taken[-1]))
        return sent

    servos.send_goals = command
    return out


def _obeyed_s(
    house: ServedArm, out: list[tuple[float, object]], before: object, said_s: float
) -> float:
    deadline_s = said_s + 1.0
    while time.perf_counter() < deadline_s:
        for at_s, setpoint in out[-20:]:
            if (
                at_s > said_s
                and setpoint is not before
                and setpoint is house.arm_thread.command.goal
            ):
                return at_s
        time.sleep(0.0005)
    return deadline_s


def arrivals_ms(speed: str, jerk_factor: float) -> tuple[list[float], list[float]]:
    """Return the times from single pointer events until all joints are within 2 ticks of the goal.

    The events turn a joint by about 0.3 degrees.
    The first list is for the reference positions of the joints, the second for the simulated
    shafts; an event whose goal is not reached in a second counts as one second.
    """
    should: list[float] = []
    shafts: list[float] = []
    arm_thread_module.HAND_JERK_FACTOR = jerk_factor  # pyright: ignore[reportConstantRedefinition]
    with served("so101", "home") as (house, page):
        page.say("set_speed", name=speed)
        grab(house, page, 560, 250)
        page.live_for(2.0)
        for count in range(ARRIVALS):
            before, said_s = house.arm_thread.command.goal, time.perf_counter()
            page.point("move", 560 + 0.45 * (count % 4), 250 + 0.45 * (count % 3))
            times: dict[str, float] = {}
            while len(times) < 2 and time.perf_counter() - said_s < 1.0:
                page.receive_for(0.002)
                if house.arm_thread.command.goal is not before:
                    _note_arrivals(house, times, said_s)
            should.append(times.get("should", 1000.0))
            shafts.append(times.get("shafts", 1000.0))
            page.live_for(0.3)
    return should, shafts


def _note_arrivals(house: ServedArm, times: dict[str, float], said_s: float) -> None:
    """Record the times [ms] at which the joints should be, and are, within 2 ticks of the goal."""
    snapshot, goal = house.arm_thread.snapshot, house.arm_thread.command.goal
    if goal is None or snapshot.reference is None:
        return
    for name, positions in (("should", snapshot.reference), ("shafts", snapshot.measured)):
        if np.abs(positions - goal).max() <= 2 * math.tau / 4096:
            times.setdefault(name, 1000 * (time.perf_counter() - said_s))


def drag() -> tuple[int, int]:
    """Return the number of received moves of a drag, and the maximum lag."""
    with served("so101", "home") as (house, page):
        received: list[int] = []
        receive: Callable[..., None] = house.controller.receive
        said = 0

        def receive_counted(client_id: int, message: Any) -> None:  # noqa: ANN401
            receive(client_id, message)
            if isinstance(message, Pointer) and message.phase == "move":
                received.append(said - len(received) - 1)

        house.controller.receive = receive_counted
        grab(house, page, 560, 250)
        for count in range(MOVES):
            said += 1
            page.point("move", 560 - count / 2, 250 + count / 4)
            page.live_for(1 / 60)
        page.live_for(0.5)
        return len(received), max(received)


def traffic_kb_s(view: str, *, webgl: bool) -> tuple[float, float]:
    """Return the traffic to one page at rest and while it drags the arm, kB/s."""
    with served("so101", "home") as (house, page):
        page.say("viewport", w=900, h=700, dpr=1, view=view, webgl=webgl)
        page.live_for(2.0)
        begun, page.received_bytes = time.monotonic(), 0
        page.live_for(SECONDS)
        idle = page.received_bytes / (time.monotonic() - begun)
        grab(house, page, 450, 300)
        begun, page.received_bytes, moves = time.monotonic(), 0, 0
        while (since_s := time.monotonic() - begun) < SECONDS:
            across, down = 150 * math.sin(2 * since_s), 100 * math.sin(3.5 * since_s)
            page.point("move", 450 + across, 300 + down)
            moves += 1
            page.receive_for(max(0.001, begun + moves * REFRESH_S - time.monotonic()))
        return idle / 1000, page.received_bytes / (time.monotonic() - begun) / 1000


def page_share(view: str, *, webgl: bool) -> tuple[float, float, float]:
    """Return the share of a core that the page's thread takes at rest and dragging, in percent.

    It is a thread of the process that streams the goals. The third number is the moves per second.
    """
    with served("so101", "home") as (house, page):
        page.say("viewport", w=900, h=700, dpr=1, view=view, webgl=webgl)
        page.live_for(2.0)
        (server,) = [each for each in threading.enumerate() if each.name.endswith("(run)")]
        clock = time.pthread_getcpuclockid(server.ident or 0)
        begun, before = time.monotonic(), time.clock_gettime(clock)
        page.live_for(SECONDS)
        idle = (time.clock_gettime(clock) - before) / (time.monotonic() - begun)
        grab(house, page, 450, 300)
        begun, before, moves = time.monotonic(), time.clock_gettime(clock), 0
        while (since_s := time.monotonic() - begun) < SECONDS:
            across, down = 150 * math.sin(2 * since_s), 100 * math.sin(3.5 * since_s)
            page.point("move", 450 + across, 300 + down)
            moves += 1
            page.receive_for(max(0.001, begun + moves * REFRESH_S - time.monotonic()))
        passed_s = time.monotonic() - begun
        dragged = (time.clock_gettime(clock) - before) / passed_s
        return 100 * idle, 100 * dragged, moves / passed_s


def first_picture() -> tuple[float, float]:
    """Return the size of the page, gzipped [kB], and the time to its first scene [s]."""
    entries = list((files("ikservo.apps.page") / "static").iterdir())
    kilobytes = sum(len(gzip.compress(entry.read_bytes())) for entry in entries) / 1000
    with ExitStack() as stack:
        house = ViewApp([ArmAtPort(load_model("so101"), "sim")], dead_man_s=5.0)
        urls = stack.enter_context(house)
        stack.enter_context(house.serve_in_thread())
        playwright = stack.enter_context(sync_playwright())
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        page = browser.new_page(viewport={"width": 1100, "height": 720})
        begun = time.perf_counter()
        page.goto(urls.control)
        while not page.evaluate("window.ikservo?.drawn > 0"):
            page.wait_for_timeout(10)
        took_s = time.perf_counter() - begun
        browser.close()
        return kilobytes, took_s


def frames_per_second() -> tuple[float, float]:
    """Return the frames that differ from the one before, and the screen's refreshes, per second.

    Chromium draws an arm of ten links that is dragged.
    """
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        house = ViewApp(
            [ArmAtPort(load_model(str(ten_links(Path(folder)))), "sim")], dead_man_s=5.0
        )
        urls = stack.enter_context(house)
        stack.enter_context(house.serve_in_thread())
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
        found: list[float] = page.evaluate("[window.changed, window.refreshes].map(perSecond)")
        browser.close()
        return found[0], found[1]


# The pointer is moved inside the page at each refresh: the test's own pipe is not measured.
# A frame counts if its data differ from those of the frame before.
DRAW_ON = """() => {
  const canvas = document.getElementById("drawing");
  const began = performance.now();
  const box = canvas.getBoundingClientRect();
  let [scene, print] = [null, ""];
  window.changed = window.refreshes = 0;
  window.perSecond = (count) => 1000 * count / (performance.now() - began);
  const look = (now) => {
    window.refreshes += 1;
    if (scene !== window.ikservo.scene) {
      scene = window.ikservo.scene;
      const before = print;
      print = JSON.stringify([scene.measured, scene.goal, scene.marker, scene.camera, scene.hover]);
      window.changed += print !== before;
    }
    canvas.dispatchEvent(new PointerEvent("pointermove", { pointerId: 1, clientX: box.x + 450 +
      200 * Math.cos(now / 400), clientY: box.y + 320 + 150 * Math.sin(now / 300) }));
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
}"""


def print_latencies() -> None:
    """Measure and print the time from pointer events to goals."""
    took = sorted(latencies_ms())
    p95 = took[int(0.95 * len(took))]
    print(f"pointer to goal, {EVENTS} events: median {statistics.median(took):.1f} ms, "
          f"p95 {p95:.1f} ms, most {took[-1]:.1f} ms")  # fmt: skip


def print_arrivals() -> None:
    """Measure and print the time from pointer events until the joints have reached the goals."""
    steep = arm_thread_module.HAND_JERK_FACTOR
    for speed in ("normal", "fast"):
        for factor in (1.0, steep):
            should, shafts = map(statistics.median, arrivals_ms(speed, factor))
            print(f"to 2 ticks of the goal, {speed}, {factor:g} times the jerk: median "
                  f"{should:.0f} ms of the joints' reference, {shafts:.0f} of shafts")  # fmt: skip


def print_drag() -> None:
    """Count and print the lost moves of a drag."""
    received, lag = drag()
    print(f"one drag of {MOVES} moves: {MOVES - received} lost, at most {lag} behind")


def print_frames() -> None:
    """Measure and print the number of pictures that the browser draws."""
    changed, refreshes = frames_per_second()
    print(f"ten links, dragged: {changed:.1f} frames per second that differ, "
          f"of {refreshes:.1f} refreshes of the screen")  # fmt: skip


VIEWS = {"side": ("side", False), "orbit": ("orbit", False), "orbit, 3D": ("orbit", True)}


def print_traffic() -> None:
    """Measure and print the traffic to a page."""
    for name, (view, webgl) in VIEWS.items():
        idle, dragged = traffic_kb_s(view, webgl=webgl)
        print(f"to one page ({name}): {idle:.1f} kB/s at rest, {dragged:.0f} kB/s dragging")


def print_shares() -> None:
    """Measure and print the processor time of the page's thread."""
    for name, (view, webgl) in VIEWS.items():
        idle, dragged, moves = page_share(view, webgl=webgl)
        print(f"the page's thread ({name}): {idle:.1f} % of a core at rest, {dragged:.1f} % "
              f"dragging at {moves:.0f} moves per second")  # fmt: skip


def print_first_picture() -> None:
    """Measure and print the size of the page's files and the time until it appears."""
    kilobytes, took_s = first_picture()
    print(f"the page: {kilobytes:.0f} kB gzipped, first picture after {took_s:.2f} s")


PARTS: dict[str, Callable[[], None]] = {
    "latency": print_latencies, "arrival": print_arrivals, "drag": print_drag,
    "frames": print_frames, "traffic": print_traffic, "share": print_shares,
    "page": print_first_picture,
}  # fmt: skip


def main() -> None:
    """Run the requested measurements and print the results."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"all, or some of {list(PARTS)}")
    wanted = parser.parse_args().parts or list(PARTS)
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    for part in wanted:
        PARTS[part]()
    print(f"load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
