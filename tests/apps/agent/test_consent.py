"""A person allows each plan, on a page of this machine or in a terminal; the agent cannot."""

import json
import threading
import time
import urllib.error
import urllib.request
from contextlib import contextmanager

import pytest

from ikservo.apps.agent import consent_terminal
from ikservo.apps.agent.allowance import Allowance, Consent
from ikservo.apps.agent.consent_server import address_file, consent_server, stored_address
from ikservo.apps.agent.consent_terminal import answer_in_terminal
from ikservo.apps.agent.plan_store import Answer, OfferedPlan, PlanStore
from ikservo.errors import IkservoError, InputError, RefusedError, UnknownNameError
from ikservo.planning.calibrated_arm import ZeroSource
from ikservo.planning.motions import Wait
from ikservo.planning.path_constraint import PathConstraint
from servosim.clock import VirtualClock

NEAR = [0.22, 0.04, 0.12]


class Page:
    def __init__(self, address):
        self.base, _, self.key = address.partition("#")

    def __call__(self, path, method="GET", **headers):
        headers = {"authorization": f"Bearer {self.key}"} | headers
        request = urllib.request.Request(self.base + path, method=method, headers=headers)
        with urllib.request.urlopen(request, timeout=20) as answer:
            return answer.read()

    def status(self, path, method="GET", **headers):
        try:
            self(path, method, **headers)
        except urllib.error.HTTPError as error:
            return error.code
        return 200

    def wait_for_plan(self):
        for _ in range(600):
            plans = json.loads(self("plans"))["plans"]
            if plans:
                return plans[0]["id"]
            time.sleep(0.05)
        raise AssertionError("no plan was asked for")


@pytest.fixture
def asking(open_session):
    """Return a session whose owner is asked, and the page of consent."""
    with open_session(consent=Consent.ASK) as session, consent_server(session.agent) as address:
        yield session, Page(address)


@contextmanager
def executing(session, plan):
    """Execute a plan in a thread; yield the list that its result is appended to."""
    results = []
    thread = threading.Thread(
        target=lambda: results.append(session.call("execute", plan_id=plan)), daemon=True
    )
    thread.start()
    yield results
    thread.join(60)
    assert results


def test_motion_waits_for_consent_of_a_person(asking):
    session, page = asking
    plan = session.plan(move_to={"position_m": NEAR})
    with executing(session, plan) as results:
        assert page.wait_for_plan() == plan
        assert not session.has_moved
        assert page(f"plans/{plan}.png").startswith(b"\x89PNG")
        page(f"plans/{plan}/yes", "POST")
    assert results[0]["status"] == "done"
    assert session.has_moved


def test_plan_refused_by_user_is_never_executed(asking):
    session, page = asking
    plan = session.plan(move_to={"position_m": NEAR})
    with executing(session, plan) as results:
        page(f"plans/{page.wait_for_plan()}/no", "POST")
    assert "refused plan" in results[0]
    assert page.status(f"plans/{plan}/yes", "POST") == 409
    assert "refused plan" in session.call("execute", plan_id=plan)
    assert not session.has_moved


def test_plan_without_answer_can_be_approved_later(asking, monkeypatch):
    session, page = asking
    monkeypatch.setattr("ikservo.apps.agent.mcp_server._CONSENT_WAIT_S", 0.2)
    plan = session.plan(move_to={"position_m": NEAR})
    waiting = session.call("execute", plan_id=plan)
    assert waiting["status"] == "waiting_for_consent"
    assert not session.has_moved
    page(f"plans/{plan}/yes", "POST")
    assert session.call("execute", plan_id=plan)["status"] == "done"


def test_consent_page_refuses_wrong_key_host_and_origin(asking):
    _, page = asking
    assert page.status("plans") == 200
    assert page.status("plans", authorization="Bearer x") == 401
    assert page.status("plans", host="evil.example") == 403
    assert page.status("plans", origin="http://evil.example") == 403
    assert page.status("") == 200
    assert page.status("stop") == 405
    assert page.status("plans/none/yes", "POST") == 409
    assert page.status("plans/none/maybe", "POST") == 404


def test_consent_page_stops_arm_and_acknowledges_the_stop(asking):
    session, page = asking
    page("stop", "POST")
    assert "A person stopped the arm" in json.loads(page("plans"))["stopped_for"]
    page("acknowledge", "POST")
    assert json.loads(page("plans"))["stopped_for"] == ""
    assert session.agent.arm.stop_reason is None


def test_consent_terminal_asks_per_plan_and_ends_with_server(open_session, monkeypatch, capsys):
    with open_session(consent=Consent.ASK) as session:
        plan = session.plan(move_to={"position_m": NEAR})
        with consent_server(session.agent):
            asked = []

            def answer(question):
                asked.append(question)
                if len(asked) > 1:
                    raise KeyboardInterrupt
                return True

            monkeypatch.setattr(consent_terminal, "confirm", answer)
            session.agent.ask(plan, "test")
            other = session.plan(wait={"duration_s": 1.0})
            session.agent.ask(other, "test")
            with pytest.raises(KeyboardInterrupt):
                answer_in_terminal()
        assert session.agent.plans.find(plan).answer is Answer.YES
        assert session.agent.plans.find(other).answer is Answer.NONE
        assert plan in capsys.readouterr().out
    with pytest.raises(InputError, match="No agent is connected"):
        answer_in_terminal()


def test_consent_mode_nothing_refuses_every_agent_motion(open_session):
    with open_session(consent=Consent.NOTHING) as session:
        plan = session.plan(move_to={"position_m": NEAR})
        assert "does not allow any motion" in session.call("execute", plan_id=plan)
        assert session.agent.plans.asked() == []
        assert not session.has_moved


@pytest.mark.parametrize(
    ("allowance", "zeros"),
    [
        (Allowance(Consent.SIMULATOR), ZeroSource.CALIBRATED),
        (Allowance(Consent.SLOW), ZeroSource.CALIBRATED),
    ],
)
def test_consent_option_unsuitable_for_calibration_is_refused(allowance, zeros):
    with pytest.raises(InputError):
        allowance.check(zeros)


def test_agent_plans_expire_and_oldest_is_dropped_when_full():
    clock = VirtualClock()
    store = PlanStore(clock)
    first = store.offer(OfferedPlan([Wait(1.0)], None, ["wait"]))
    clock.sleep_until(clock.now_s() + 301.0)
    with pytest.raises(RefusedError, match="has expired"):
        store.take(first.id)
    ids = {store.offer(OfferedPlan([Wait(1.0)], None, ["wait"])).id for _ in range(50)}
    assert len(ids) == 50
    with pytest.raises(UnknownNameError):
        store.find(first.id)


def test_consent_terminal_reports_that_server_has_ended(monkeypatch):
    monkeypatch.setattr(consent_terminal, "stored_address", lambda: "http://127.0.0.1:9/#key")
    with pytest.raises(IkservoError, match="has disconnected"):
        answer_in_terminal()


def test_plan_refusal_withdraws_earlier_consent():
    store = PlanStore(VirtualClock())
    plan = store.offer(OfferedPlan([Wait(1.0)], None, ["wait"]))
    for answer in (Answer.YES, Answer.NO, Answer.YES):
        if plan.answer is not Answer.NO:
            store.answer(plan.id, answer, "a person")
    with pytest.raises(RefusedError, match="A person refused"):
        store.take(plan.id)


def test_ending_server_does_not_remove_address_of_newer_one(open_session):
    with open_session() as session, consent_server(session.agent):
        with consent_server(session.agent) as later:
            pass
        with consent_server(session.agent) as later:
            address_file().write_text(json.dumps({"address": "of another"}))
        assert stored_address() == "of another" != later


def test_motion_after_end_of_allowed_time_needs_consent_again(open_session):
    region = PathConstraint(low_m=(-0.5, -0.4, 0.0), high_m=(0.5, 0.4, 0.5))
    with open_session(consent=Consent.SLOW, within=region, minutes=0.001) as session:
        plan = session.plan(wait={"duration_s": 0.1})
        offered = session.agent.plans.find(plan)
        offered.answer, offered.answered_by = Answer.YES, "--allow slow"  # just before the end
        time.sleep(0.1)
        assert "need no approval has ended" in session.call("execute", plan_id=plan)
        later = session.call("plan", motion={"wait": {"duration_s": 0.1}})
        assert later["needs_consent"]


def test_executed_motion_withdraws_other_consent_requests(open_session):
    with open_session(consent=Consent.ASK) as session:
        agent = session.agent
        first, second = (session.plan(move_to={"position_m": NEAR}) for _ in range(2))
        for plan in (first, second):
            agent.ask(plan, "test")
        assert [each.id for each in agent.plans.asked()] == [first, second]
        agent.plans.answer(second, Answer.YES, "a person")
        assert session.call("execute", plan_id=second)["status"] == "done"
        assert agent.plans.asked() == []
