"""The code blocks of README and docs: place, language, and whether they can run.

A fence names its language: ```` ```sh ````. A block that cannot run in a test says why::

    ```sh {data-no-run="needs an arm"}

A command that must fail gives its exit code: ``{data-exit="7"}``.
"""

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]

_MARKER = re.compile(
    r"^(?P<indent> *)```(?P<info>[^\n]*)\n(?P<text>.*?)^(?P=indent)```$", re.S | re.M
)
_INFO = re.compile(
    r'(?P<language>[a-z]*)(?: \{(?:data-(?P<key>no-run|exit)="(?P<value>[^"]+)")\})?'
)


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Attributes:
        page: Its page, from the root of the repository.
        line: Line of its fence, counted from 1.
        language: The language that the fence names.
        reason: Why it cannot run; empty if it can.
        exit_code: Expected exit code of its commands.
        text: Its content.
    """

    page: str
    line: int
    language: str
    reason: str
    exit_code: int
    text: str

    def __str__(self):
        return f"{self.page}:{self.line}"

    @property
    def commands(self):
        """Return each command with its printed lines, as far as they are shown."""
        if self.language == "console":
            for command in self.text.split("$ ")[1:]:
                words, _, printed = command.partition("\n")
                yield words, printed
        if self.language == "sh":
            for line in self.text.splitlines():
                if line.strip() and not line.lstrip().startswith("#"):
                    yield line.strip(), None


def blocks(page):
    """Return the blocks of a page in their order."""
    text = page.read_text("utf-8")
    return [_block(page, text, found) for found in _MARKER.finditer(text)]


def _block(page, text, found):
    info = _INFO.fullmatch(found["info"])
    line = text.count("\n", 0, found.start()) + 1
    place = str(page.relative_to(ROOT))
    assert info, f"{place}:{line}: ```{found['info']} is no language with an attribute of ours"
    value = {info["key"]: info["value"]}
    indent = found["indent"]
    body = re.sub(f"^{indent}", "", found["text"], flags=re.M)
    exit_code = int(value.get("exit", 0))
    return Block(place, line, info["language"], value.get("no-run", ""), exit_code, body)
