from setuptools import find_packages, setup

NAME = "ctrl_rl_robot"

setup(
    name=NAME,
    version="0.1.0",
    description="Learning on the robot: an environment over topics, take-over, fine-tuning behind the safety filter.",
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
            "fine_tune = ctrl_rl_robot.cli.fine_tune:fine_tune",
            "shift_study = ctrl_rl_robot.cli.shift_study:shift_study",
        ],
    },
)
