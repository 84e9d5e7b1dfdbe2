from setuptools import find_packages, setup

NAME = "ctrl_rl_learning"

setup(
    name=NAME,
    version="0.1.0",
    description="Learning: resumable runs, networks, Stable-Baselines3, from bags alone, on the robot, from an expert.",
    license="Apache-2.0",
    maintainer="Seed 5ee16a79 maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-5ee16a79.example",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "evaluate = ctrl_rl_learning.cli.evaluate:evaluate",
            "evaluate_offline = ctrl_rl_learning.cli.evaluate_offline:evaluate_offline",
            "export = ctrl_rl_learning.cli.export:export",
            "fine_tune = ctrl_rl_learning.cli.fine_tune:fine_tune",
            "learn_offline = ctrl_rl_learning.cli.learn_offline:learn_offline",
            "teach = ctrl_rl_learning.cli.teach:teach",
        ],
    },
)
