"""Tests in Chromium: the system's own, or one that is installed for them."""

import os
import shutil
import subprocess

import pytest
from playwright.sync_api import sync_playwright

from tests.browser.page_operator import Operator, serve_view

SOFTWARE_WEBGL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
INSTALL = (
    ["apt-get", "update"],
    ["apt-get", "install", "-y", "--no-install-recommends", "chromium"],
)


TIMEOUT_S = 300  # time of a test: several waits, each as long as the ``TIMEOUT_S`` of an operator


def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.parent.name == "browser" and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(TIMEOUT_S))


def found():
    return next(filter(None, map(shutil.which, NAMES)), None)


def installed():
    """Return why Chromium cannot be installed here; empty once it is installed."""
    if shutil.which("apt-get") is None or not hasattr(os, "geteuid") or os.geteuid() != 0:
        return "no Chromium here, and only root with apt-get could install it"
    for command in INSTALL:
        done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    return "" if done.returncode == 0 else f"Chromium cannot be installed: {done.stderr[-200:]}"


@pytest.fixture(scope="session")
def chromium_path(tmp_path_factory):
    """Return a program that starts Chromium with the rights of a user.

    If root starts it, it raises the priority of its drawing process and delays an arm in real time.
    """
    reason = "" if found() else installed()
    if reason:
        pytest.skip(reason)
    if shutil.which("setpriv") is None or os.geteuid() != 0:
        return found()
    program = tmp_path_factory.mktemp("chromium") / "chromium"
    program.write_text(f'#!/bin/sh\nexec setpriv --bounding-set -sys_nice {found()} "$@"\n')
    program.chmod(0o755)
    return program


@pytest.fixture(scope="package")
def browser(chromium_path):
    """Start Chromium for the tests of this folder.

    Playwright leaves an event loop running, with which other tests would fail in ``asyncio.run``.
    """
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium_path, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def webgl_browser(browser, chromium_path):
    """Yield a Chromium whose WebGL is drawn in software: slow, but the same picture everywhere."""
    arguments = ["--no-sandbox", *SOFTWARE_WEBGL]
    webgl = browser.browser_type.launch(executable_path=chromium_path, args=arguments)
    yield webgl
    webgl.close()


@pytest.fixture(scope="module")
def shared():
    with serve_view() as view:
        yield view


@pytest.fixture
def view(request):
    """Yield a view of a simulated arm in real time, with the arm at home.

    Most tests share one; a test that parametrizes it indirectly with options gets its own.
    """
    if not hasattr(request, "param"):
        yield request.getfixturevalue("shared").brought_home()
        return
    with serve_view(**request.param) as own:
        yield own


@pytest.fixture
def visit(browser, view, request):
    """Return a function that opens the page as a person would: visit(key, **context options)."""

    def arrive(*, watch=False, **options):
        context = browser.new_context(viewport={"width": 1100, "height": 720}, **options)
        request.addfinalizer(context.close)
        return Operator(context.new_page(), view, watch=watch)

    return arrive


@pytest.fixture
def operator(visit):
    return visit()


@pytest.fixture
def live(operator):
    """Return a user who has switched Live on, at the fast speed, with the arm at rest."""
    return operator.enable_live().until_still()
