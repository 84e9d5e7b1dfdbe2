from setuptools import setup

NAME = "ttr_reward_node"

setup(
    name=NAME,
    version="0.1.0",
    description="Time-to-reach rewards from Hamilton-Jacobi value functions (thesis 3.2).",
    license="Apache-2.0",
    packages=[NAME],
    package_data={"ttr_reward_node": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "check = ttr_reward_node.cli:check",
            "relabel = ttr_reward_node.cli:relabel_bag",
            "reward = ttr_reward_node.node:main",
            "slices = ttr_reward_node.cli:slices",
            "solve = ttr_reward_node.cli:solve_value",
            "ttr_experiments = ttr_reward_node.experiments_cli:main",
            "train = ttr_reward_node.training_cli:train",
            "training_figures = ttr_reward_node.training_cli:training_figures",
        ],
    },
)
