"""The page of messages and services, from their definitions."""

from __future__ import annotations

from pathlib import Path

from workspace import ROOT

_HEAD = """# Messages and services

The definitions of `ctrl_rl_msgs`, each field with unit and frame. Frames and units follow REP-103, REP-105 and REP-117.
"""


def message_page() -> str:
    """Return the page: an introduction and a table of fields for each definition."""
    folder = ROOT / "ctrl_rl_msgs"
    files = [*sorted(folder.glob("msg/*.msg")), *sorted(folder.glob("srv/*.srv"))]
    return "\n".join((_HEAD, *(_section(file) for file in files)))


def _section(file: Path) -> str:
    words, rows = [], []
    for line in file.read_text(encoding="utf-8").splitlines():
        field, _, comment = line.partition("#")
        if not field.strip() and not rows:
            words.append(comment.strip())
        elif line.strip() == "---":
            rows.append("| **answer** | | |")
        elif field.strip():
            kind, name = field.split(maxsplit=1)
            rows.append(f"| `{name.strip()}` | `{kind}` | {_cell(comment)} |")
        elif comment.strip() and rows:
            rows.append(f"| | | {_cell(comment)} |")
    head = "| field | type | meaning |\n|---|---|---|"
    text = "\n".join(words).strip()
    return f"## {file.name}\n\n{text}\n\n{head}\n" + "\n".join(rows) + "\n"


def _cell(text: str) -> str:
    return text.strip().replace("|", "\\|")
