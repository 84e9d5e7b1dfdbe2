from glob import glob

from setuptools import find_packages, setup

NAME = "ctrl_rl_navigation"

setup(
    name=NAME,
    version="0.1.0",
    description="Drives a robot to any goal on a map by the time to reach it.",
    license="Apache-2.0",
    maintainer="Seed 5ee16a79 maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-5ee16a79.example",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "*.pyi", "maps/*.yaml", "maps/*.pgm"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
        (f"share/{NAME}/config", glob("config/*")),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "navigator = ctrl_rl_navigation.nodes.navigator_node:main",
            "map_server = ctrl_rl_navigation.nodes.map_node:main",
            "trials = ctrl_rl_navigation.trials:trials",
        ],
    },
)
