"""Pages of the documentation that are written from the sources: see ``GENERATED``.

Each module writes one page as Markdown, or one kind of drawing. ``hook`` gives the pages to MkDocs
when the site is built; tests call the same functions, so they need no MkDocs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pages.commands import commands_page
from pages.error_messages import error_messages_page
from pages.formats import arm_toml_page, page_protocol_page, programs_page
from pages.registers import registers_page

__all__ = ["GENERATED", "generated_pages"]

GENERATED: Mapping[str, Callable[[], str]] = {
    "reference/commands.md": commands_page,
    "reference/arm-toml.md": arm_toml_page,
    "reference/programs.md": programs_page,
    "reference/page-protocol.md": page_protocol_page,
    "reference/registers.md": registers_page,
    "reference/error-messages.md": error_messages_page,
}
"""Functions that write the pages, by path in ``docs``."""


def generated_pages() -> dict[str, str]:
    """Return the Markdown of each generated page, by its path in ``docs``."""
    return {path: write() for path, write in GENERATED.items()}
