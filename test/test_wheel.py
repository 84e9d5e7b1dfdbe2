"""One wheel without ROS: declares all that it imports, carries its data, and runs the README's lines of Python."""

import ast
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
ROS = re.compile(r"rclpy|launch\w*|ament_index_python|\w+_(msgs|srvs|interfaces)|rpyutils|rosidl\w*")
FOLDERS = sorted(file.parent.name for file in ROOT.glob("*/setup.py"))


def python_of(readme: str) -> str:
    """Return the README's lines of Python."""
    (block,) = re.findall(r"^```python\n(.*?)^```$", readme, re.MULTILINE | re.DOTALL)
    return block


def declared(extras: tuple[str, ...]) -> list[Requirement]:
    """Return what the project and some of its extras need."""
    more = [text for extra in extras for text in PROJECT["optional-dependencies"][extra]]
    found = map(Requirement, (*PROJECT["dependencies"], *more))
    return [each for each in found if each.marker is None or each.marker.evaluate()]


def _applies(requirement: Requirement, extras: set[str]) -> bool:
    marker = requirement.marker
    return marker is None or any(marker.evaluate({"extra": extra}) for extra in ("", *extras))


def closure(requirements: list[Requirement]) -> set[str]:
    """Return the names of all distributions that requirements bring, of those that are installed here."""
    found: set[str] = set()
    todo = [(each.name, each.extras) for each in requirements]
    while todo:
        name, extras = todo.pop()
        if canonicalize_name(name) in found:
            continue
        try:
            needs = importlib.metadata.requires(name) or []
        except importlib.metadata.PackageNotFoundError:  # a part of torch's builds for other accelerators
            continue
        found.add(canonicalize_name(name))
        wanted = [each for each in map(Requirement, needs) if _applies(each, extras)]
        todo += [(each.name, each.extras) for each in wanted]
    return found


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from what git would keep."""
    folder = tmp_path_factory.mktemp("source")
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--"]
    names = [*FOLDERS, "pyproject.toml", "setup.cfg", "README.md", "LICENSE"]
    for name in subprocess.run([*listed, *names], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
        "\n"
    ):
        if name and (ROOT / name).is_file() and "/test/" not in name:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, folder / name)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*command, "--wheel-dir", folder / "dist", folder], check=True, capture_output=True)
    (built,) = (folder / "dist").glob("ctrl_rl-*.whl")
    return built


def test_it_carries_all_modules_and_data(wheel: Path) -> None:
    inside = set(zipfile.ZipFile(wheel).namelist())
    endings = {".py", ".pyi", ".yaml", ".safetensors", ".urdf", ".pgm", ".typed"}
    for package in FOLDERS:
        for file in (ROOT / package / package).rglob("*"):
            if file.is_file() and "__pycache__" not in file.parts:
                assert file.suffix in endings, f"{file}: an ending that [tool.setuptools.package-data] does not have"
                assert str(file.relative_to(ROOT / package)) in inside
    assert not {name for name in inside if "/test" in name or name.startswith("test")}


def test_policies_are_found_as_in_the_workspace() -> None:
    offered = {}
    for setup in ROOT.glob("*/setup.py"):
        for line in re.findall(r'"ctrl_rl.policies": \[(.*?)\]', setup.read_text("utf-8"), re.DOTALL):
            offered |= dict(each.split(" = ") for each in re.findall(r'"([^"]+)"', line))
    assert PROJECT["entry-points"]["ctrl_rl.policies"] == offered


OPTIONAL = {"warp": "warp-lang"}
"""Distributions of modules that `requirements/development.txt` leaves out."""


def test_it_declares_whatever_its_modules_import() -> None:
    names = {canonicalize_name(each.name) for each in declared(tuple(PROJECT["optional-dependencies"]))}
    owners = importlib.metadata.packages_distributions()
    for file in (file for package in FOLDERS for file in (ROOT / package / package).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                modules = [str(node.module)]
            for module in (each.partition(".")[0] for each in modules):
                if module in sys.stdlib_module_names or module in FOLDERS or ROS.fullmatch(module):
                    continue
                owned = {canonicalize_name(owner) for owner in owners.get(module, [OPTIONAL.get(module, module)])}
                assert owned & names, f"{file.relative_to(ROOT)} imports {module}: declare it in pyproject.toml"


def bare_environment(folder: Path, wheel: Path, extras: tuple[str, ...]) -> Path:
    """Make an environment of the wheel and what it declares, which is borrowed from this one; return its Python."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    (site,) = folder.glob("lib/python*/site-packages")
    zipfile.ZipFile(wheel).extractall(site)
    for name in closure(declared(extras)):
        for top in {file.parts[0] for file in importlib.metadata.files(name) or ()} - {"..", "__pycache__"}:
            if not (site / top).exists():
                (site / top).symlink_to(Path(str(importlib.metadata.distribution(name).locate_file(top))))
    return folder / "bin" / "python"


def run_readme(python: Path, folder: Path, lines: str) -> str:
    """Run lines where there is no ROS; return what they print."""
    folder.mkdir()
    variables = {key: value for key, value in os.environ.items() if not re.match("PYTHON|AMENT|ROS|VIRTUAL", key)}
    code = f"import importlib.util as u\nassert not u.find_spec('rclpy')\n{lines}"
    command = [python, "-W", "ignore", "-c", code]
    answer = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    assert (folder / "mine.safetensors").is_file()
    return answer.stdout


@pytest.fixture(scope="module")
def bare(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Python of an environment with the wheel, what it declares, and the extra that the README names."""
    return bare_environment(tmp_path_factory.mktemp("bare"), wheel, ("learn",))


def test_the_readme_s_lines_run_in_a_bare_environment(bare: Path, tmp_path: Path) -> None:
    lines = python_of((ROOT / "README.md").read_text("utf-8"))
    assert len([line for line in lines.splitlines() if line.strip()]) <= 10
    quick = lines
    for words, less in (("solve(task)", "solve(task, counts=(31, 31, 16))"), ("60_000", "2_048"), ("(20)", "(1)")):
        assert words in quick
        quick = quick.replace(words, less)
    quick = quick.replace(', filter="safety"', "")  # which takes ten seconds to compile
    assert "reach the goal" in run_readme(bare, tmp_path / "run", quick)


@pytest.mark.slow
def test_the_readme_s_lines_do_what_the_readme_says(bare: Path, tmp_path: Path) -> None:
    said = run_readme(bare, tmp_path / "run", python_of((ROOT / "README.md").read_text("utf-8")))
    success, collisions = (int(number) for number in re.findall(r"(\d+)%", said))
    assert success >= 70
    assert collisions == 0
