"""Over TLS the page can be operated from another machine."""

import pytest

from tests.browser.page_operator import Operator, serve_view, with_long_timeout
from tests.browser.test_browser_safety import FAR

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def far_view(own_address):
    with serve_view(listen=own_address) as view:
        yield view


def test_arm_is_moved_by_a_page_over_tls(browser, far_view):
    context = browser.new_context(ignore_https_errors=True)
    operator = Operator(context.new_page(), far_view)
    assert far_view.urls.control.startswith("https://")
    operator.enable_live().until_still()
    operator.click(operator.tip_px() + FAR).until_moving()
    operator.page.click("#stop")
    operator.wait_for("status.mode === 'stopped'").until_still()
    assert operator.errors == []
    context.close()


def test_browser_rejects_page_with_unknown_certificate(browser, far_view):
    context = browser.new_context()
    page = with_long_timeout(context.new_page())
    with pytest.raises(Exception, match="ERR_CERT_AUTHORITY_INVALID"):
        page.goto(far_view.urls.control)
    context.close()
