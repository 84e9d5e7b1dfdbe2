from glob import glob

from setuptools import find_packages, setup

NAME = "ctrl_rl_safety"

setup(
    name=NAME,
    version="0.1.0",
    description="Lets commands through to a robot as far as they are provably recoverable.",
    license="Apache-2.0",
    maintainer="Seed 5ee16a79 maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-5ee16a79.example",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "*.pyi", "*/*.pyi", "trials/attackers/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "safety_filter = ctrl_rl_safety.nodes.safety_filter_node:main",
            "flight_guard = ctrl_rl_safety.nodes.flight_guard_node:main",
            "identify = ctrl_rl_safety.cli.identify:main",
            "train = ctrl_rl_safety.cli.simulated:train",
            "trials = ctrl_rl_safety.cli.simulated:trials",
        ],
    },
)
