from glob import glob

from setuptools import find_packages, setup

NAME = "ctrl_rl_bringup"

setup(
    name=NAME,
    version="0.1.0",
    description="Launch files, parameter files and the demo that starts everything.",
    license="Apache-2.0",
    maintainer="Seed 5ee16a79 maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-5ee16a79.example",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "*.pyi"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", sorted(glob("launch/*.py"))),
        (f"share/{NAME}/config", sorted(glob("config/*"))),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "animate = ctrl_rl_bringup.cli.animate:animate",
            "compile = ctrl_rl_bringup.cli.compile:compile_kernels",
            "demo = ctrl_rl_bringup.cli.drive:demo",
            "monitor = ctrl_rl_bringup.cli.drive:monitor",
            "options_demo = ctrl_rl_bringup.cli.team:demo",
            "options_monitor = ctrl_rl_bringup.cli.team:monitor",
            "options_report = ctrl_rl_bringup.cli.team:report",
            "preflight = ctrl_rl_bringup.cli.preflight:preflight",
            "record_drives = ctrl_rl_bringup.cli.drive:record_drives",
            "report = ctrl_rl_bringup.cli.drive:report",
            "results = ctrl_rl_bringup.cli.drive:results",
            "transfer = ctrl_rl_bringup.cli.transfer:transfer",
            "trials = ctrl_rl_bringup.cli.drive:trials",
        ],
    },
)
