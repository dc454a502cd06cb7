"""Who looks at a page in a real browser."""

import time

from watching import PATIENCE_S


class Reader:
    """A reader of a page; `faults` are errors, and requests to elsewhere than `allowed`."""

    def __init__(self, browser, url, allowed=(), **look):
        context = browser.new_context(accept_downloads=True, **look)
        context.set_default_timeout(1e3 * PATIENCE_S)
        self.page, self.faults = context.new_page(), []
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on("console", lambda said: said.type == "error" and self.faults.append(said.text))
        known = ("blob:", "data:", url.partition("?")[0], *allowed)
        self.page.on(
            "request", lambda one: one.url.startswith(known) or self.faults.append(one.url)
        )
        self.page.goto(url)

    def until(self, condition):
        """Wait for a condition; the page's policy forbids Playwright's own way."""
        end = time.monotonic() + PATIENCE_S
        while not self.page.evaluate(condition):
            assert time.monotonic() < end, condition
            time.sleep(0.05)

    def follow(self, link):
        """Click a link, and wait for its page: meanwhile, the one before it would answer."""
        with self.page.expect_navigation():
            self.page.click(link)
