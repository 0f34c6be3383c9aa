"""Names of picture sources, without the passwords in their addresses."""

from __future__ import annotations

import re
from urllib.parse import urlsplit

HIDDEN = "…"
_PUBLIC_QUERY = re.compile(
    r"(action|camera|channel|fps|height|profile|quality|resolution|stream|subtype|width)"
    r"=[\w.x-]{1,12}",
    re.ASCII | re.IGNORECASE,
)
"""Parts of a query that select the picture; any other part may be a password."""


def public_source(source: str) -> str:
    """Return the name of a picture source, without any password in it.

    All messages, pages and files use this name for a source. It keeps the scheme, host, port and
    path, and the parts of the query that are known to be harmless; "…" replaces the rest. A name
    that is already public stays the same.
    """
    scheme, separator, rest = source.rpartition("://") if "://" in source else ("", "", source)
    if not separator:
        user, at, place = source.rpartition("@")  # an address without a scheme
        return f"{HIDDEN}@{place}" if at and ":" in user else source
    user, at, place = rest.rpartition("@")  # the last one: passwords may contain "@", "/" and "?"
    try:
        parts = urlsplit(f"//{place}")
        host, port = parts.hostname or "", f":{parts.port}" if parts.port else ""
    except ValueError:  # no valid port or address
        host, port, parts = HIDDEN, "", urlsplit("")
    path = "/".join(HIDDEN if "=" in part else part for part in parts.path.split("/"))
    query = "&".join(
        part if _PUBLIC_QUERY.fullmatch(part) else HIDDEN for part in parts.query.split("&")
    )
    return (
        f"{scheme if re.fullmatch(r'[A-Za-z0-9+.-]+', scheme) else HIDDEN}://"
        f"{f'{HIDDEN}@' if at else ''}{f'[{host}]' if ':' in host else host}{port}{path}"
        f"{f'?{query}' if parts.query else ''}{f'#{HIDDEN}' if parts.fragment else ''}"
    )
