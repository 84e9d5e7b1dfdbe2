from setuptools import setup

NAME = "koopman_lqr_controller"

setup(
    name=NAME,
    version="0.1.0",
    description="Koopman control from lidar: a learned linear model and its LQR (thesis 2.3 and 4).",
    license="Apache-2.0",
    packages=[NAME, f"{NAME}.training"],
    package_data={"koopman_lqr_controller": ["py.typed", "policies/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "analyse = koopman_lqr_controller.analysis_cli:analyse",
            "compare = koopman_lqr_controller.training.compare_cli:compare",
            "comparison_figures = koopman_lqr_controller.training.compare_cli:comparison_figures",
            "consolidate = koopman_lqr_controller.training_cli:consolidate",
            "controller = koopman_lqr_controller.node:main",
            "evaluate = koopman_lqr_controller.offline_cli:evaluate",
            "fit = koopman_lqr_controller.offline_cli:fit",
            "learn = koopman_lqr_controller.training_cli:learn",
            "learn_offline = koopman_lqr_controller.offline_cli:learn_offline",
            "scripted_driver = koopman_lqr_controller.scripted_driver_node:main",
            "train = koopman_lqr_controller.two_stage_cli:main",
        ],
    },
)
