from setuptools import find_packages, setup

NAME = "ctrl_rl_trials"

setup(
    name=NAME,
    version="0.1.0",
    description="Trials that compare: a ladder of tasks, ways to use a value function, BARN, transfer, closed loops.",
    license="Apache-2.0",
    maintainer="Seed 5ee16a79 maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-5ee16a79.example",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "tasks/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "barn = ctrl_rl_trials.cli.barn:barn",
            "correlation = ctrl_rl_trials.cli.correlation:correlation",
            "hardness = ctrl_rl_trials.cli.tasks:hardness",
            "loop = ctrl_rl_trials.cli.loop:loop",
            "page = ctrl_rl_trials.cli.tasks:page",
            "plot = ctrl_rl_trials.cli.learning:plot",
            "shift_study = ctrl_rl_trials.cli.shift_study:shift_study",
            "train = ctrl_rl_trials.cli.learning:train",
        ],
    },
)
