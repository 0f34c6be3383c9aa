"""Hooks that MkDocs calls when it builds the site: generated pages, and formulas as MathML."""

from __future__ import annotations

import html
import re
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from latex2mathml.converter import convert
from mkdocs.structure.files import File

from pages import generated_pages

_FORMULA = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\\[(\[](?P<latex>.*?)\\[)\]]</(?P=tag)>', re.S
)


def on_files(files: Any, config: Any) -> Any:  # noqa: ANN401  # MkDocs' own types
    """Add the generated pages to those of ``docs``."""
    for path, text in generated_pages().items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(text: str, page: Any, **_: object) -> str:  # noqa: ANN401
    """Rank the project's records below the pages for users when the site is searched."""
    if any(each.title == "Project" for each in page.ancestors):
        page.meta["search"] = {"boost": 0.2}
    return text


def on_page_content(text: str, **_: object) -> str:
    """Replace formulas in TeX by MathML, which browsers draw without a script."""
    return _FORMULA.sub(_to_mathml, text)


def _to_mathml(found: re.Match[str]) -> str:
    display = "block" if found["tag"] == "div" else "inline"
    return convert(html.unescape(found["latex"]), display=display)
