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
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "compare = koopman_lqr_controller.compare_cli:compare",
            "comparison_figures = koopman_lqr_controller.compare_cli:comparison_figures",
            "consolidate = koopman_lqr_controller.training_cli:consolidate",
            "controller = koopman_lqr_controller.node:main",
            "learn = koopman_lqr_controller.training_cli:learn",
            "scripted_driver = koopman_lqr_controller.scripted_driver_node:main",
            "train = koopman_lqr_controller.cli:main",
        ],
    },
)
