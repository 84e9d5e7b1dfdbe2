"""MkDocs hook that converts $$equations$$ and $`formulas`$ to MathML, which browsers render without scripts."""

from __future__ import annotations

import re
from typing import Any

from latex2mathml.converter import convert

_CODE = re.compile(r"(^```.*?^```|`[^`$\n]*`(?!\$))", re.DOTALL | re.MULTILINE)
_BLOCK = re.compile(r"\$\$(.+?)\$\$", re.DOTALL)
_INLINE = re.compile(r"\$`([^`\n]+)`\$")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Return a page's text with its formulas converted to MathML."""
    # Markdown takes <math> at the start of a line for a block, which would end the paragraph there.
    text = _INLINE.sub(lambda match: f"<span>{convert(match[1])}</span>", markdown)
    parts = _CODE.split(text)
    return "".join(part if index % 2 else _BLOCK.sub(_block, part) for index, part in enumerate(parts))


def _block(match: re.Match[str]) -> str:
    return f'<div class="equation">{convert(" ".join(match[1].split()), display="block")}</div>'
