"""A browser page on a service, and the watch over what it does."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal
from urllib.parse import urlsplit

from playwright.sync_api import ConsoleMessage, Error, Page, Request, Response

from tests.e2e.service import Service

_FAILED_LOAD = re.compile(r"Failed to load resource: the server responded with a status of (\d+)")


@dataclass
class Watch:
    """Notes what must not happen on a page."""

    host: str
    faults: list[str] = field(default_factory=list)
    expected: list[tuple[int, str]] = field(default_factory=list)
    may_lose_requests: bool = False
    """Whether requests without any answer are part of the test."""

    def follow(self, page: Page) -> None:
        """Watch this page from now on."""
        page.on("console", self._console)
        page.on("pageerror", self._error)
        page.on("request", self._request)
        page.on("response", self._response)

    def verify(self) -> None:
        """Fail if anything happened that must not."""
        assert not self.faults, "\n".join(self.faults)

    def is_expected(self, status: int, url: str) -> bool:
        path = urlsplit(url).path
        return any(status == one and re.fullmatch(pattern, path) for one, pattern in self.expected)

    def _console(self, message: ConsoleMessage) -> None:
        if message.type not in {"error", "warning"}:
            return
        failed = _FAILED_LOAD.match(message.text)
        if failed and self.is_expected(int(failed[1]), message.location["url"]):
            return
        if self.may_lose_requests and "net::ERR_FAILED" in message.text:
            return
        self.faults.append(f"console {message.type}: {message.text} ({message.location})")

    def _error(self, error: Error) -> None:
        self.faults.append(f"exception: {error.stack or error}")

    def _request(self, request: Request) -> None:
        parts = urlsplit(request.url)
        if parts.scheme not in {"blob", "data"} and parts.netloc != self.host:
            self.faults.append(f"request to another host: {request.url}")

    def _response(self, response: Response) -> None:
        if response.status >= 400 and not self.is_expected(response.status, response.url):
            self.faults.append(f"{response.request.method} {response.url}: {response.status}")


@dataclass
class Dashboard:
    """A page of the dashboard."""

    page: Page
    service: Service
    watch: Watch

    def open(self, path: str, *, key: str | None = None) -> Page:
        """Open a page (``/venues``) signed in with this key, as admin without one; waits until it is drawn."""
        secret = self.service.key if key is None else key
        self.page.add_init_script(f"sessionStorage.setItem('isodyn.key', '{secret}')")
        self.page.goto(f"/#{path}")
        self.page.locator("main .page[data-ready]").wait_for()
        return self.page

    def expect(self, status: int, path: str) -> None:
        """Do not mind this answer; ``path`` is a regular expression of the whole path."""
        self.watch.expected.append((status, path))

    def colours(self, scheme: Literal["light", "dark"]) -> None:
        """Show the page as to someone whose system is light or dark."""
        self.page.emulate_media(color_scheme=scheme)

    def resize(self, width: int, height: int = 800) -> None:
        """Give the window another size."""
        self.page.set_viewport_size({"width": width, "height": height})

    def screenshot(self, name: str, *, full: bool = True) -> None:
        """Keep a picture, if the tests are run with ISODYN_SCREENSHOTS=folder."""
        folder = os.environ.get("ISODYN_SCREENSHOTS")
        if folder:
            Path(folder).mkdir(parents=True, exist_ok=True)
            self.page.screenshot(path=Path(folder) / f"{name}.png", full_page=full)

    def screenshots(self, name: str) -> None:
        """Pictures in light, in dark, and on a phone."""
        self.page.evaluate("scrollTo(0, 0)")
        for scheme in ("light", "dark"):
            self.colours(scheme)  # type: ignore[arg-type]
            self.screenshot(f"{name}-{scheme}")
        self.colours("light")
        self.resize(375, 812)
        self.screenshot(f"{name}-phone")
        self.resize(1280)

    def fits(self) -> bool:
        """Whether nothing makes the page wider than the window."""
        return bool(self.page.evaluate("document.documentElement.scrollWidth <= innerWidth"))
