from setuptools import find_packages, setup

NAME = "ttr_reward_node"

setup(
    name=NAME,
    version="0.1.0",
    description="Time-to-reach rewards from Hamilton-Jacobi value functions (thesis 3.2).",
    license="Apache-2.0",
    maintainer="Seed 5ee16a79 maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-5ee16a79.example",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "*.pyi"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "check = ttr_reward_node.cli.values:check",
            "relabel = ttr_reward_node.cli.values:relabel_bag",
            "reward = ttr_reward_node.nodes.reward_node:main",
            "slices = ttr_reward_node.cli.values:slices",
            "solve = ttr_reward_node.cli.values:solve_value",
            "ttr_experiments = ttr_reward_node.cli.experiments:main",
            "evaluate = ttr_reward_node.cli.learning:evaluate",
            "export = ttr_reward_node.cli.learning:export",
            "plot = ttr_reward_node.cli.learning:plot",
            "train = ttr_reward_node.cli.learning:train",
            "training_figures = ttr_reward_node.cli.learning:training_figures",
        ],
    },
)
