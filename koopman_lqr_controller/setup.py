from setuptools import find_packages, setup

NAME = "koopman_lqr_controller"

setup(
    name=NAME,
    version="0.1.0",
    description="Koopman control from lidar: a learned linear model and its LQR (thesis 2.3 and 4).",
    license="Apache-2.0",
    maintainer="Seed 5ee16a79 maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-5ee16a79.example",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "policies/pretrained/*", "*.pyi"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "analyse = koopman_lqr_controller.cli.analyse:analyse",
            "compare = koopman_lqr_controller.cli.learning:compare",
            "comparison_figures = koopman_lqr_controller.cli.learning:comparison_figures",
            "consolidate = koopman_lqr_controller.cli.learning:consolidate",
            "controller = koopman_lqr_controller.nodes.controller_node:main",
            "edmd = koopman_lqr_controller.cli.edmd:main",
            "evaluate = koopman_lqr_controller.cli.offline:evaluate",
            "fit = koopman_lqr_controller.cli.offline:fit",
            "learn = koopman_lqr_controller.cli.learning:learn",
            "learn_offline = koopman_lqr_controller.cli.offline:learn_offline",
            "plot = koopman_lqr_controller.cli.learning:plot",
            "scripted_driver = koopman_lqr_controller.nodes.scripted_driver_node:main",
            "train = koopman_lqr_controller.cli.learning:train",
        ],
        "ctrl_rl.policies": ["policy = koopman_lqr_controller.policies.driving:KIND"],
    },
)
