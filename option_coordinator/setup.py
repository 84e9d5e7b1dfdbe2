from setuptools import find_packages, setup

NAME = "option_coordinator"

setup(
    name=NAME,
    version="0.1.0",
    description="Grants options to robots that finish at different times (thesis 2.4 and 5).",
    license="Apache-2.0",
    maintainer="Seed 5ee16a79 maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-5ee16a79.example",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "*.pyi", "teams/*.yaml", "policies/pretrained/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "coordinator = option_coordinator.nodes.coordinator_node:main",
            "navigation_agent = option_coordinator.nodes.navigation_agent:main",
            "evaluate = option_coordinator.learning:evaluate",
            "evaluate_offline = option_coordinator.learning:evaluate_offline",
            "replay = option_coordinator.cli:replay",
            "loop = option_coordinator.learning:loop",
            "train = option_coordinator.learning:train",
            "plot = option_coordinator.learning:plot",
            "training_figures = option_coordinator.learning:training_figures",
        ],
    },
)
