"""The README as a package index shows it: its links and images lead to the repository.

They stay as they are until `[project.urls]` in pyproject.toml names the repository as `Source`.
"""

import re
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface


def absolute(text: str, source: str) -> str:
    """A README whose images and links begin with the address of the repository."""
    text = re.sub(r'((?:src|srcset)="|!\[[^\]]*\]\()(?!http)', rf"\1{source}/raw/HEAD/", text)
    return re.sub(r"((?<!!)\[[^\]]*\]\()(?!http|#)", rf"\1{source}/blob/HEAD/", text)


class Readme(MetadataHookInterface):
    """Gives the project its README."""

    def update(self, metadata: dict) -> None:
        """Add the key `readme`."""
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        if source := metadata["urls"].get("Source"):
            text = absolute(text, source)
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
