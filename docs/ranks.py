"""How well the search of the built pages finds: `python docs/ranks.py docs/_build/html`.

Prints the rank of the right page for each query of `docs/queries.txt`, by a browser. A line there
is a query, a bar, and the pages that answer it. Needs '.[dev]' and `playwright install chromium`,
or the path of a Chromium in the environment variable CHROMIUM.
"""

import os
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

HERE = Path(__file__).parent
FIND = """query => Search._performSearch(...Search._parseQuery(query)).reverse()
    .map(([page, title, anchor]) => [page, anchor])"""


def main(site: Path) -> None:
    """Print a line for each query, and how many are first, and among three."""
    lines = (HERE / "queries.txt").read_text(encoding="utf-8").splitlines()
    queries = [[part.strip() for part in line.split("|")] for line in lines if line]
    ranks = []
    with sync_playwright() as browsers:
        browser = browsers.chromium.launch(executable_path=os.environ.get("CHROMIUM"))
        page = browser.new_page()
        page.goto((site / "search.html").resolve().as_uri())
        page.wait_for_function("Search.hasIndex()")
        for query, right in queries:
            found = page.evaluate(FIND, query)
            rank = next((n for n, one in enumerate(found, 1) if one[0] in right.split()), 0)
            ranks.append(rank)
            first = "".join(part or "" for part in found[0]) if found else "nothing"
            print(f"{rank or '–':>3}  {query:<28} {right:<26} first: {first}")
        browser.close()
    n_first, n_three = ranks.count(1), sum(0 < rank <= 3 for rank in ranks)
    print(f"{n_first} of {len(ranks)} first, {n_three} among three")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
