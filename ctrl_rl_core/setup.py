from setuptools import setup

NAME = "ctrl_rl_core"

setup(
    name=NAME,
    version="0.1.0",
    description="What every package shares: robot system models, tasks, value grids, bags, the recorder.",
    license="Apache-2.0",
    packages=[NAME],
    package_data={"ctrl_rl_core": ["py.typed", "task_files/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "bag = ctrl_rl_core.bag_cli:main",
            "recorder = ctrl_rl_core.recorder_node:main",
            "watchdog = ctrl_rl_core.watchdog_node:main",
        ],
    },
)
