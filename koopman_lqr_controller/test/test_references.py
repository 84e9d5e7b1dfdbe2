"""Published figures: one file has them, and pages and the results file repeat it."""

import json
import re
from pathlib import Path

import pytest
from koopman_lqr_controller.training.experiments.references import PublishedCurve, publications, published_means
from pydantic import ValidationError

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted({ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("*/README.md")} - {ROOT / "docs/results.md"})


def quoted() -> list[tuple[str, str, int, str]]:
    """Return page, learner, figure, and text of the section of each figure that a page quotes."""
    names = "|".join(map(re.escape, publications()))
    return [
        (str(page.relative_to(ROOT)), match[1], int(match[2]), section)
        for page in PAGES
        for section in re.split(r"\n## ", page.read_text())
        for match in re.finditer(rf"\b({names})(?: has| publishes)? (\d{{2,3}})\b(?! (?:thousand|,))", section)
    ]


def test_pages_quote_what_was_published_after_as_many_frames() -> None:
    found = quoted()
    assert len(found) > 20
    for page, name, figure, section in found:
        places = [
            frames
            for curve in publications()[name].curves.values()
            for frames, mean in curve.means().items()
            if abs(mean - figure) < 0.56  # means are kept to a tenth
        ]
        assert any(f"{frames:,}" in section for frames in places), f"{page}: {name} {figure}, published: {places}"


def test_the_results_file_has_the_same_figures() -> None:
    rows = json.loads((ROOT / "docs/results/references.json").read_text())["rows"]
    assert len(rows) > 100
    for row in rows:
        task, name = row["method"].split(", ")
        frames = int(row["metric"].split()[2].replace(",", ""))
        assert row["values"] == [publications()[name].curves[task].means()[frames]]


def test_means_end_where_our_own_curve_does() -> None:
    means = published_means("cheetah_run", 200_000)
    assert means["SimbaV2"] == {100_000: 641.8, 200_000: 801.9}
    assert published_means("cheetah_run", 10_000) == {}
    assert published_means("no_such_task", 1e6) == {}


def test_a_curve_of_two_lengths_is_refused() -> None:
    with pytest.raises(ValidationError, match="one length"):
        PublishedCurve(seeds=3, frames=[1, 2], mean=[1.0], deviation=[1.0])
