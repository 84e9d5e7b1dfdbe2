from glob import glob

from setuptools import setup

NAME = "ctrl_rl_bringup"

setup(
    name=NAME,
    version="0.1.0",
    description="Launch files, parameter files and the demo that starts everything.",
    license="Apache-2.0",
    packages=[NAME],
    package_data={"ctrl_rl_bringup": ["py.typed"]},
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
            "demo = ctrl_rl_bringup.cli:demo",
            "monitor = ctrl_rl_bringup.cli:monitor",
            "options_demo = ctrl_rl_bringup.options_cli:demo",
            "options_monitor = ctrl_rl_bringup.options_cli:monitor",
            "options_report = ctrl_rl_bringup.options_cli:report",
            "record_drives = ctrl_rl_bringup.cli:record_drives",
            "report = ctrl_rl_bringup.cli:report",
            "results = ctrl_rl_bringup.cli:results",
            "trials = ctrl_rl_bringup.cli:trials",
        ],
    },
)
