"""The packages' README files as pages of the site, with links adjusted to the site's structure."""

from __future__ import annotations

import re

from workspace import PACKAGES, ROOT

_LINK = re.compile(r"\]\((?!https?:|#|mailto:)([^)#]+)(#[^)]*)?\)")


def package_pages() -> dict[str, str]:
    """Return the pages by file name."""
    return {f"{package}.md": _page(package) for package in PACKAGES if (ROOT / package / "README.md").exists()}


def _page(package: str) -> str:
    text = (ROOT / package / "README.md").read_text(encoding="utf-8")

    def turned(match: re.Match[str]) -> str:
        target, anchor = match.group(1), match.group(2) or ""
        place = (ROOT / package / target).resolve().relative_to(ROOT)
        if place.parts[0] == "docs":
            return f"](../{'/'.join(place.parts[1:])}{anchor})"
        if place.name == "README.md" and len(place.parts) == 2:
            return f"]({place.parts[0]}.md{anchor})"
        return f"](https://{'/'.join(place.parts)})"

    return _LINK.sub(turned, text)
