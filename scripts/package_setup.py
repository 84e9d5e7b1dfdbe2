"""Shared setup of all packages: common settings are defined here, the rest comes from each package.xml."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping, Sequence
from glob import glob
from pathlib import Path
from xml.etree import ElementTree as ET

from setuptools import find_packages, setup  # type: ignore[import-untyped]

DATA = ("py.typed", "**/*.pyi", "**/*.yaml", "**/*.pgm", "**/*.safetensors", "**/*.urdf")
"""Data files of a package, as in pyproject.toml."""


def setup_package(entry_points: Mapping[str, Sequence[str]] | None = None) -> None:
    """Set up the package in the working folder, from which colcon calls it.

    Args:
        entry_points: Executables (`console_scripts`) and plug-ins, as setuptools takes them.
    """
    root = ET.parse("package.xml").getroot()
    name, maintainer = root.findtext("name"), root.find("maintainer")
    if name is None or maintainer is None or not Path(name).is_dir():
        sys.exit("package.xml names no maintainer, or no package of this folder")
    shared = [(f"share/{name}/{folder}", sorted(glob(f"{folder}/*.*"))) for folder in ("launch", "config")]
    setup(
        name=name,
        version=root.findtext("version"),
        description=root.findtext("description"),
        license=root.findtext("license"),
        maintainer=maintainer.text,
        maintainer_email=maintainer.get("email"),
        packages=find_packages(include=[name, f"{name}.*"]),
        package_data={name: list(DATA)},
        data_files=[
            ("share/ament_index/resource_index/packages", [f"resource/{name}"]),
            (f"share/{name}", ["package.xml"]),
            *((place, files) for place, files in shared if files),
        ],
        install_requires=["setuptools"],
        extras_require={"test": ["pytest"]},
        zip_safe=False,
        entry_points={
            group: [_through_door(line) for line in lines] if group == "console_scripts" else list(lines)
            for group, lines in (entry_points or {}).items()
        },
    )


def _through_door(line: str) -> str:
    """Return the console script of an executable that `ctrl_rl_core.entry` imports and runs."""
    name, _, place = line.partition(" = ")
    module, _, function = place.partition(":")
    source = Path(f"{module.replace('.', '/')}.py")
    text = source.read_text(encoding="utf-8") if source.exists() else ""
    kind = "node" if re.search(r"return run_nodes?\(", text) else "command"
    return f"{name} = ctrl_rl_core.entry:{kind}.{module}.{function}"
