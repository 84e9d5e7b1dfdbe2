"""Every picture is drawn, from committed results or something small, and no word in it is cut or in the way."""

import json
import re

import numpy as np
import pytest
from ctrl_rl_core.plots import Line, Panel, draw_learning, draw_path, draw_paths, picture, word_at
from matplotlib.figure import Figure
from picture_faults import RESULTS, ROOT, assert_clean, figures_of

from ctrl_rl_core import load_navigation_task


@pytest.mark.parametrize("learner", ["ppo", "sac"])
def test_the_ladder(drawn, tmp_path, learner):
    from ctrl_rl_trials.ladder import LadderFigures, draw_ladder

    assert len(draw_ladder(figures_of("ladder", LadderFigures), learner, tmp_path)) == 2
    assert_clean(drawn)


def test_the_tasks_of_the_ladder(drawn, tmp_path):
    from ctrl_rl_trials.ladder import LADDER, draw_pages, load_ladder_task

    list(draw_pages([load_ladder_task(name) for name in LADDER], tmp_path / "tasks.png"))
    assert_clean(drawn)


def test_mpc_in_the_simulator(drawn, tmp_path):
    paths = json.loads((RESULTS / "oc_mpc_quad_navigation.json").read_text())["figures"]["paths"]
    draw_paths(tmp_path / "mpc.png", "MPC in the simulator", load_navigation_task("quad_navigation"), paths)
    corridor = [{"outcome": "COLLISION", "states": [[0.0, 0.0, 0.0], [0.3, 0.1, 0.0]]}]
    draw_paths(tmp_path / "corridor.png", "A corridor", load_navigation_task("curved_corridor"), {"MPC": corridor})
    assert_clean(drawn)


def test_what_is_wrong_is_found(drawn, tmp_path):
    with picture(tmp_path / "bad.png", half=True) as (figure, ((ax,),)):
        ax.plot([0.0, 1.0], [0.0, 1.0])
        ax.text(0.5, 0.5, "in the way", horizontalalignment="center")
        ax.text(0.0, 0.9, "small", size=6.0)
        figure.text(0.9, 0.02, "beyond the edge of the picture")
    (faults,) = drawn.values()
    assert any("'in the way' covers" in fault for fault in faults)
    assert "'small' has 6 pt" in faults
    assert any("'beyond the edge of the picture' leaves the canvas" in fault for fault in faults)


def test_lines_by_their_number_of_seeds(tmp_path):
    steps, random = np.arange(1, 6) * 1000.0, np.random.default_rng(0)
    counts = {"oc_ppo": 2, "ppo": 5, "oc_corrected": 12}
    ends = {"ppo": 3}
    lines = [
        Line(name, name, steps[: ends.get(name)], random.random((count, 5))[:, : ends.get(name)])
        for name, count in counts.items()
    ]
    held = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", lambda figure, *_, **__: held.update(figure=figure))
        draw_learning(tmp_path / "x.svg", "Seeds", [Panel("", lines)], "return")
    (ax,) = held["figure"].axes
    assert len(ax.collections) == 1  # a band from 10 seeds on
    assert sum(line.get_linewidth() == 0.7 for line in ax.lines) == 5  # a line a seed below
    assert sum(line.get_linestyle() == "None" and len(line.get_xdata()) == 5 for line in ax.lines) == 2  # points
    assert [line.get_markerfacecolor() for line in ax.lines if len(line.get_xdata()) == 1] == ["white"]  # ended early
    assert "ppo (n\u00a0=\u00a05)" in {text.get_text() for text in ax.texts}


def test_a_word_goes_where_it_covers_nothing(drawn, tmp_path):
    with picture(tmp_path / "word.png", half=True) as (_, ((ax,),)):
        ax.plot(np.linspace(0.0, 1.0, 50), np.linspace(0.0, 1.0, 50))
        for place in (0.2, 0.5, 0.8):
            word_at(ax, "a word", (place, place))
    assert_clean(drawn)


def test_a_robot_that_stands_is_marked_once(drawn, tmp_path):
    times = np.linspace(0.0, 140.0, 1401)
    x = np.minimum(0.2 * times, 3.0) + 0.2 * np.maximum(times - 130.0, 0.0)
    with picture(tmp_path / "path.png", half=True) as (_, ((ax,),)):
        draw_path(ax, np.column_stack((x, 0.0 * x)), times=times)
    words = [text.get_text() for text in ax.texts]
    assert [word for word in words if "standing" in word] == ["115 s standing"]
    assert len(words) <= 10
    assert_clean(drawn)


OWN = ("ctrl_rl_core/ctrl_rl_core/plots/", "test/test_pictures.py", "test/picture_faults.py")
LOOKS = re.compile(
    r"""["']tab:|\bcmap=["']|\b(font|label|title)size=|\bfigsize=|#[0-9A-Fa-f]{6}\b"""
    r"""|color(map)?s?=["'](?!white|none)"""
)


def test_nothing_else_names_a_colour_a_size_or_a_font():
    import subprocess

    files = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    wrong = [
        f"{name}:{number}: {line.strip()}"
        for name in files.splitlines()
        if not name.startswith(OWN) and "/test/" not in name and (ROOT / name).is_file()
        for number, line in enumerate((ROOT / name).read_text(encoding="utf-8").splitlines(), 1)
        if LOOKS.search(line)
    ]
    assert wrong == []


PAGES = sorted(set(ROOT.glob("*.md")) | set(ROOT.glob("docs/**/*.md")) | set(ROOT.glob("*/README.md")))
_PICTURE = re.compile(r"^!\[([^\]]*)\]\(([^)\s]+)\)\n\n(.*)$|!\[([^\]]*)\]\(([^)\s]+)\)", re.MULTILINE)


def shown():
    """Yield page, alternative text, picture and the line after it, of every picture on a page."""
    for page in PAGES:
        if "reference" not in page.relative_to(ROOT).parts:  # written from the READMEs
            for found in _PICTURE.finditer(page.read_text(encoding="utf-8")):
                text, target = found[1] or found[4] or "", found[2] or found[5]
                yield page, text, (page.parent / target).resolve(), found[3] or ""


def test_every_picture_is_on_a_page():
    there = {file for folder in ("images", "analysis") for file in (ROOT / "docs" / folder).rglob("*")
             if file.suffix in (".png", ".svg", ".gif", ".webp")}  # fmt: skip
    on_pages = {picture for *_, picture, _ in shown()}
    assert sorted(map(str, there - on_pages)) == []
    assert sorted(map(str, {picture for picture in on_pages if not picture.is_file()})) == []


def test_every_picture_has_a_caption_and_tells_its_finding():
    bare = [f"{page.relative_to(ROOT)}: {picture.name}" for page, _, picture, caption in shown() if caption[:1] != "*"]
    assert bare == []
    short = [f"{page.relative_to(ROOT)}: {picture.name}" for page, text, picture, _ in shown() if len(text) < 15]
    assert short == []
