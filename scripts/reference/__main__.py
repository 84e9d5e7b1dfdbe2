"""Generate the reference pages from the code: commands, parameters, topics, messages, schemas, names, policies."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from capabilities import capability_page
from commands import command_page
from ctrl_rl_bringup.cards import zoo_pages
from messages import message_page
from names import names_page
from nodes import parameter_page, topic_page
from readmes import package_pages
from schemas import schema_page
from workspace import ROOT

PAGES = {
    "capabilities.md": capability_page,
    "commands.md": command_page,
    "parameters.md": parameter_page,
    "topics.md": topic_page,
    "messages.md": message_page,
    "schemas.md": schema_page,
    "names.md": names_page,
}


def main() -> int:
    """Write the named pages, or all, to the given folder."""
    parser = argparse.ArgumentParser(prog="python scripts/reference", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder for the pages")
    parser.add_argument("page", nargs="*", help=f"pages to write instead of all: {', '.join(PAGES)}")
    given = parser.parse_args()
    if unknown := set(given.page) - set(PAGES):
        parser.error(f"there is no page {', '.join(sorted(unknown))}: there are {', '.join(PAGES)}")
    folder = given.folder
    folder.mkdir(parents=True, exist_ok=True)
    for name, page in PAGES.items():
        if given.page and name not in given.page:
            continue
        print(f"reference: {folder / name}", flush=True)
        (folder / name).write_text(page(), encoding="utf-8")
    for name, text in (package_pages() | zoo_pages(ROOT / "docs" / "results")).items():
        (folder / name).write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
