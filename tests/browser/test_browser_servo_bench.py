"""The page of servos in a browser: found, read, written, refused, restored, plotted."""

import re

import pytest
from playwright.sync_api import expect

from ikservo.apps.page.page_app import ViewApp
from ikservo.hardware.eeprom import read_backup
from ikservo.model import load_model
from tests.browser.page_operator import until, with_long_timeout
from tests.browser.test_browser_page import CONTRAST, NAMES, SMALL

pytestmark = pytest.mark.browser

ROW = "#servos-table li[data-register={}]"
ELBOW = 3
OPEN_SOCKET = """path => new Promise(done => {
  const socket = new WebSocket(location.origin.replace("http", "ws") + path);
  socket.onerror = () => done("none");
  socket.onopen = () => done("open");
})"""


class Bench:
    """The page, and the simulated servos behind it."""

    def __init__(self, app, page):
        self.app, self.page, self.errors = app, page, []
        page.on("pageerror", lambda error: self.errors.append(str(error)))

    @property
    def servos(self):
        return self.transport().line.servos

    def transport(self):
        return self.app.lines[-1]

    def choose(self, name="elbow_flex"):
        self.page.wait_for_selector("#line:has-text('elbow_flex (3) STS3215')")
        self.page.select_option("#servos-joint", name)
        self.page.wait_for_function("name => window.ikservo.shown()?.joint === name", arg=name)
        return self

    def write(self, register, text):
        field = self.page.locator(ROW.format(register) + " input")
        field.fill(text)
        field.press("Enter")

    def says(self, text):
        self.page.wait_for_selector(f"#note:has-text('{text}')")
        return self


@pytest.fixture
def bench(browser, request, tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    from servosim import open_port

    lines = []

    def open_and_note(url):
        lines.append(open_port(url))
        return lines[-1]

    monkeypatch.setattr("servosim.open_port", open_and_note)
    arm = getattr(request, "param", "so101")
    app = ViewApp([], servos=("sim", load_model(arm)))
    app.lines = lines
    with app as urls, app.serve_in_thread():
        context = browser.new_context(
            viewport={"width": 1100, "height": 720}, accept_downloads=True
        )
        bench = Bench(app, with_long_timeout(context.new_page()))
        bench.page.goto(urls.control)
        bench.urls = urls
        yield bench
        assert bench.errors == []
        context.close()


def test_servo_page_reads_writes_and_protects_registers(bench):
    bench.choose()
    field = bench.page.locator(ROW.format("p_gain") + " input")
    assert field.input_value() == str(bench.servos[ELBOW].read("p_gain"))
    bench.write("p_gain", "20")
    bench.says("p_gain 32 → 20")
    assert bench.servos[ELBOW].read("p_gain") == 20
    expect(bench.page.locator(ROW.format("p_gain"))).to_contain_text("was 32, default 32")
    bench.write("p_gain", "255")
    bench.says("255 is outside 0 to 254")
    bench.write("max_temperature_limit", "60C")
    bench.says("max_temperature_limit 70 → 60")
    assert [bench.servos[ELBOW].read(n) for n in ("p_gain", "lock")] == [20, 1]
    for name in ("goal_position", "id", "lock", "present_position", "torque_enable"):
        assert bench.page.locator(ROW.format(name) + " input").get_attribute("readonly") is not None


def test_servo_page_switches_torque_and_then_refuses_writing(bench):
    bench.choose()
    before = bench.servos[ELBOW].read("present_position")
    bench.page.click("#torque")
    bench.page.wait_for_selector("#torque[aria-pressed=true]")
    assert bench.servos[ELBOW].read("torque_enable") == 1
    assert abs(bench.servos[ELBOW].read("goal_position") - before) < 60, "where it is, sagging"
    bench.write("p_gain", "20")
    bench.says("holds a joint, which could fall if values change")
    assert bench.servos[ELBOW].read("p_gain") == 32
    bench.page.click("#torque")
    bench.page.click("#torque:has-text('may fall')")
    bench.page.wait_for_selector("#torque[aria-pressed=false]")
    assert bench.servos[ELBOW].read("torque_enable") == 0


def test_servo_page_downloads_and_restores_a_backup(bench, tmp_path):
    bench.choose()
    with bench.page.expect_download() as waiting:
        bench.page.click("#backup")
    path = tmp_path / waiting.value.suggested_filename
    waiting.value.save_as(path)
    assert path.name == "003_STS3215.toml"
    assert read_backup(path).eeprom["p_gain"] == 32
    bench.write("p_gain", "20")
    bench.says("→ 20")
    bench.page.set_input_files("#restore", path)
    bench.says("p_gain 20 → 32")
    assert bench.servos[ELBOW].read("p_gain") == 32
    path.write_text(path.read_text().replace("STS3215", "STS3250"))
    bench.page.set_input_files("#restore", path)
    bench.says("is a backup of a STS3250")
    path.write_text("nothing")
    bench.page.set_input_files("#restore", path)
    bench.page.wait_for_selector("#note:not(:has-text('STS3250'))")
    assert bench.servos[ELBOW].read("p_gain") == 32


def test_servo_page_plots_chosen_registers(bench):
    bench.choose()
    bench.page.fill("#servos-filter", "present_v")
    bench.page.click("#plot")
    bench.page.wait_for_selector(".chart[data-quantity=present_voltage] canvas")
    assert bench.page.locator(".chart").count() == 1
    bench.page.wait_for_function("() => window.ikservo.charts()[0].times.length > 8")
    assert bench.page.evaluate("window.ikservo.charts()[0].values[0].at(-1)") == 7.4
    bench.page.fill("#servos-filter", "")
    bench.page.click("#plot")
    bench.page.wait_for_selector(".chart[data-quantity=present_temperature] canvas")
    assert bench.page.locator(".chart").count() == 7


@pytest.mark.parametrize("bench", ["koch"], indirect=True)
def test_servo_page_switches_led_and_restarts_a_dynamixel(bench):
    bench.page.wait_for_selector("#line:has-text('XL330-M288')")
    bench.page.select_option("#servos-joint", "gripper")
    bench.page.wait_for_function("() => window.ikservo.shown()?.joint === 'gripper'")
    bench.page.click("#led")
    bench.page.wait_for_selector("#led[aria-pressed=true]")
    assert bench.servos[6].read("led") == 1
    bench.page.click("#reboot")
    bench.page.click("#reboot:has-text('will go off')")
    bench.says("restarted; torque off")
    assert bench.servos[6].read("led") == 0


def test_servo_page_asks_for_new_id_and_refuses_id_in_use(bench):
    bench.choose()
    for new_id, said in ((4, "belongs to another servo"), (9, "id 3 → 9")):
        bench.page.fill("#new-id", str(new_id))
        bench.page.click("#assign")
        assert ELBOW in bench.servos
        bench.page.click("#assign:has-text('sure')")
        bench.says(said)
    until(lambda: 9 in bench.servos)
    assert ELBOW not in bench.servos


def test_servo_page_with_watch_key_writes_nothing(bench):
    bench.choose()
    bench.page.goto("about:blank")
    bench.page.goto(bench.urls.watch)
    bench.page.wait_for_selector(ROW.format("p_gain"))
    bench.write("p_gain", "20")
    bench.says("can only watch")
    assert bench.servos[ELBOW].read("p_gain") == 32
    opened = len(bench.app.lines)
    assert (
        bench.page.evaluate(OPEN_SOCKET, "/arms")
        == bench.page.evaluate(OPEN_SOCKET, "/live")
        == "none"
    )
    assert len(bench.app.lines) == opened, "no port but the one that was named"


def test_servo_page_is_legible_and_finger_sized(bench):
    bench.choose()
    bench.page.click("#plot")
    bench.page.wait_for_selector(".chart canvas")
    for width in (390, 1100):
        bench.page.set_viewport_size({"width": width, "height": 844})
        assert bench.page.evaluate(CONTRAST) == []
        assert bench.page.evaluate(SMALL, 24) == []
        assert all(bench.page.evaluate(NAMES))
        assert bench.page.evaluate("document.documentElement.scrollWidth") <= width


def test_servo_page_searches_bus_again_and_shows_firmware(bench):
    bench.choose()
    bench.page.click("#search")
    until(lambda: len(bench.app.lines) > 1)
    bench.choose()
    assert re.search(r"3\.\d+", bench.page.inner_text("#line")), "versions of firmware"


SLIDER = "#gains input[name={}]"


@pytest.mark.parametrize("bench", ["so101"], indirect=True)
def test_servo_page_tries_gains_with_plot_before_saving(bench):
    page = bench.choose("wrist_roll").page
    assert page.locator("#gains input").count() == 6, "P, I, D, start-up force, two dead zones"
    page.fill("#step", "5")
    page.locator(SLIDER.format("p_gain")).fill("64")
    expect(page.locator("#gains label:has(input[name=p_gain]) output")).to_have_text("64")
    page.click("#try")
    page.click("#try:has-text('sure')")
    page.wait_for_function("() => window.ikservo.trial()")
    assert page.evaluate("window.ikservo.trial().values.length") == 3
    assert page.locator("#trial-chart canvas").count() == 1
    page.wait_for_selector("#servos-title:has-text('id 5')")
    servo = bench.servos[5]
    assert servo.read("p_gain") == 32, "only tried"
    assert page.locator(SLIDER.format("p_gain")).input_value() == "64"
    page.click("#save")
    bench.says("p_gain 32 → 64")
    assert servo.read("p_gain") == 64
