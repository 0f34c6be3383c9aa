"""Files that a page requested can be fetched once, in time, and by the right client."""

import csv

import httpx
import pytest

from ikservo.apps.page.messages import page_messages as msg
from ikservo.apps.page.messages.page_messages import BadMessageError
from ikservo.apps.page.server.auth import AccessTokens
from ikservo.apps.page.server.downloads import Download, DownloadOffers
from ikservo.apps.page.server.server import BoundAddress, make_app, serve_in_thread
from tests.apps.page.socket_clients import RecordingController, arm_channel
from tests.apps.page.view_session import ViewSession


class HandClock:
    time_s = 0.0

    def now_s(self):
        return self.time_s


@pytest.fixture
def clock():
    return HandClock()


@pytest.fixture
def offers(clock):
    return DownloadOffers(clock)


@pytest.fixture
def url(offers, clock):
    app = make_app([arm_channel(RecordingController())], AccessTokens.generate(), clock, offers)
    with serve_in_thread(app, BoundAddress("127.0.0.1", 0)) as url:
        yield url


FILE = Download("arm.csv", lambda: iter(["a,b\r\n", "1,2\r\n"]))


def test_download_link_works_only_once(url, offers):
    address = f"{url}/{offers.offer(FILE)}"
    response = httpx.get(address)
    assert response.text == "a,b\r\n1,2\r\n"
    assert response.headers["content-disposition"] == 'attachment; filename="arm.csv"'
    assert response.headers["cache-control"] == "no-store"
    assert httpx.get(address).status_code == 404


def test_unknown_download_address_serves_nothing(url):
    assert httpx.get(f"{url}/download/{'A' * 32}").status_code == 404


def test_download_expires_after_30_s(url, offers, clock):
    address = f"{url}/{offers.offer(FILE)}"
    clock.time_s = 31.0
    assert httpx.get(address).status_code == 404


def test_download_by_other_site_is_refused_and_stays_available(url, offers):
    address = f"{url}/{offers.offer(FILE)}"
    foreign = {"origin": "http://evil.example", "sec-fetch-site": "cross-site"}
    assert httpx.get(address, headers=foreign).status_code == 403
    assert httpx.get(address).status_code == 200


def test_only_16_latest_downloads_are_kept(offers):
    for _ in range(1000):
        offers.offer(FILE)
    assert len(offers._offers) == 16


def test_history_of_moving_arm_is_downloaded_with_goals():
    with ViewSession() as session:
        session.enable_live()
        session.send_message(msg.GoToPose, name="rest")
        session.run(cycles=150)
        session.send_message(msg.SaveHistory)
        frames = session.latest_frames()
        assert frames["download"]["name"] == "so101-history.csv"
        rows = list(csv.DictReader(downloaded(session, frames["download"]["url"])))
        assert len(rows) >= 30
        goals = [float(row["shoulder_lift_goal_deg"]) for row in rows]
        assert max(goals) - min(goals) > 0.5
        assert {row["shoulder_lift_voltage_v"] for row in rows} == {"7.4"}
        assert "download" not in session.latest_frames()


def test_plot_of_stop_is_available_only_after_a_stop():
    with ViewSession() as session:
        with pytest.raises(BadMessageError, match="Nothing has stopped"):
            session.send_message(msg.SaveHistory, stopped=True)
        session.send_message(msg.Stop)
        session.arm_thread.step()
        session.send_message(msg.ShowPlots, quantities=["voltage"], joints=[], stopped=True)
        assert "Stopped from the page" in session.latest_frames()["plots"]["reason"]


def downloaded(session, url):
    _, download = session.controller.downloads._offers[url.rpartition("/")[2]]
    return "".join(download.make()).splitlines()
