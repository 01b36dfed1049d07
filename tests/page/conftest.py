"""A browser, a daemon with a software rig, and where the screenshots go."""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, expect, sync_playwright

from tests.daemon_process import Daemon, write_bench

CHROMIUM = "/usr/bin/chromium"
ARGUMENTS = [
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
]
OUTPUT = Path(__file__).parent / "output"
REFERENCE = Path(__file__).parent.parent.parent / "recordings"
HARMLESS = ("ERR_CONNECTION", "WebSocket", "Failed to load resource")
"""What Chromium itself writes where a daemon is gone, or refuses: no fault of the page."""
PATIENCE_MS = 60_000
expect.set_options(timeout=PATIENCE_MS)


@dataclass
class Screen:
    """A page of the daemon, and all that it complained about."""

    page: Page
    complaints: list[str] = field(default_factory=list)

    def heard(self, message: ConsoleMessage) -> None:
        """Keep errors of the page's own."""
        if message.type == "error" and not any(word in message.text for word in HARMLESS):
            self.complaints.append(message.text)

    def open(self, daemon: Daemon, view: str = "live") -> Page:
        """A view of a daemon's page, once it is in contact."""
        self.page.goto(f"{daemon.url}/#/{view}")
        self.page.wait_for_selector("#state:not([data-state=unknown])")
        return self.page

    def shoot(self, name: str) -> None:
        """Keep what can be seen now."""
        OUTPUT.mkdir(exist_ok=True)
        self.page.screenshot(path=OUTPUT / f"{name}.png")


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Chromium, once."""
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield started
        started.close()


@pytest.fixture
def screen(browser: Browser) -> Iterator[Screen]:
    """A tablet's screen; the page's own errors fail the test."""
    page = browser.new_page(viewport={"width": 1024, "height": 768})
    page.set_default_timeout(PATIENCE_MS)
    screen = Screen(page)
    page.on("console", screen.heard)
    page.on("pageerror", lambda error: screen.complaints.append(str(error)))
    yield screen
    page.close()
    assert screen.complaints == []


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Daemon]:
    """A daemon that starts a software rig for each run."""
    with Daemon(write_bench(tmp_path)) as started:
        yield started


@pytest.fixture
def library(tmp_path: Path) -> Iterator[Daemon]:
    """A daemon over copies of the reference recordings."""
    (tmp_path / "recordings").mkdir()
    for recording in REFERENCE.glob("*.mcap"):
        shutil.copy(recording, tmp_path / "recordings")
    with Daemon(write_bench(tmp_path)) as started:
        yield started
