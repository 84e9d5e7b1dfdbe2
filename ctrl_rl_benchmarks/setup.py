from setuptools import find_packages, setup

NAME = "ctrl_rl_benchmarks"

setup(
    name=NAME,
    version="0.1.0",
    description="Tasks that tell learning methods apart, and the comparison of ways to use a value function.",
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
            "barn = ctrl_rl_benchmarks.cli.barn:barn",
            "hardness = ctrl_rl_benchmarks.cli.tasks:hardness",
            "page = ctrl_rl_benchmarks.cli.tasks:page",
            "plot = ctrl_rl_benchmarks.cli.learning:plot",
            "teach = ctrl_rl_benchmarks.cli.teaching:teach",
            "train = ctrl_rl_benchmarks.cli.learning:train",
        ],
    },
)
