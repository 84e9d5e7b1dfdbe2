"""The pages hold together: links lead to files and headings, the README fits on a screen, .ci/run calls its test."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    ROOT / name
    for name in subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.md"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
)
GENERATED = ROOT / "docs" / "reference"
"""Written by scripts/reference; `make docs` checks the links that lead there."""
_LINK = re.compile(r"\]\((?!https?:|mailto:)([^)\s]+)\)")
_HEADING = re.compile(r"^#+ +(.+)$", re.MULTILINE)
_CODE = re.compile(r"^```.*?^```|`[^`\n]+`", re.DOTALL | re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """Return what headings of a page are called in links."""
    plain = (re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading) for heading in _HEADING.findall(page.read_text("utf-8")))
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in plain}


def test_there_are_pages() -> None:
    assert len(PAGES) > 30


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for link in _LINK.findall(_CODE.sub("", page.read_text(encoding="utf-8"))):
        target, _, anchor = link.partition("#")
        place = (page.parent / target).resolve() if target else page
        if place.parent == GENERATED:
            continue
        assert place.exists(), f"{link} leads nowhere"
        if anchor and place.suffix == ".md":
            assert anchor in anchors(place), f"{link}: no such heading"


def test_the_site_shows_every_page() -> None:
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    named = set(re.findall(r": ([\w/]+\.md)$", text, re.MULTILINE))
    there = {str(page.relative_to(ROOT / "docs")) for page in PAGES if page.is_relative_to(ROOT / "docs")}
    assert there <= named
    assert {name for name in named if not name.startswith("reference/")} <= there
    assert yaml.safe_load(text)["site_name"] == "ctrl_rl"


def test_the_readme_fits_on_a_screen_and_moves() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 70
    (picture,) = re.findall(r"!\[[^\]]+\]\((\S+\.gif)\)", text)
    assert 0 < (ROOT / picture).stat().st_size < 1_500_000


def test_the_automatic_run_calls_the_test_of_the_readme() -> None:
    assert "make test" in (ROOT / "README.md").read_text(encoding="utf-8")
    assert re.search(r"^make test$", (ROOT / ".ci" / "run").read_text(encoding="utf-8"), re.MULTILINE)


def test_the_page_of_file_schemas_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "scripts" / "reference"))
    page = importlib.import_module("schemas").schema_page()
    assert "### NavigationTask" in page
    assert "| `footprint` |" in page


def test_the_reference_takes_help_and_unknown_pages_for_no_folder(tmp_path: Path) -> None:
    command = (sys.executable, ROOT / "scripts" / "reference")
    asked = subprocess.run((*command, "--help"), cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "usage: python scripts/reference" in asked.stdout
    wrong = subprocess.run((*command, "site", "nopage.md"), cwd=tmp_path, capture_output=True, text=True, check=False)
    assert wrong.returncode == 2
    assert "there is no page nopage.md" in wrong.stderr
    assert not list(tmp_path.iterdir())
