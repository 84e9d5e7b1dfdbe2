"""`dir()` of each room lists what the page lists."""

import re
from importlib import import_module
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "learning.md").read_text(encoding="utf-8")
TABLES = dict(re.findall(r"^## ([\w.]+)\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL))


@pytest.mark.parametrize("room", TABLES)
def test_a_room_lists_what_its_page_lists(room: str) -> None:
    assert dir(import_module(room)) == sorted(re.findall(r"^\| `(\w+)` \|", TABLES[room], re.MULTILINE))
