from setuptools import find_packages, setup

NAME = "oc_baseline_node"

setup(
    name=NAME,
    version="0.1.0",
    description="Optimal-control return-to-go as a policy-gradient baseline (thesis 3.3).",
    license="Apache-2.0",
    maintainer="Seed 5ee16a79 maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-5ee16a79.example",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "*.pyi", "values/pretrained/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "analyse = oc_baseline_node.training.analysis.cli:main",
            "baseline = oc_baseline_node.node:main",
            "oc = oc_baseline_node.cli:main",
            "evaluate = oc_baseline_node.learning:evaluate",
            "export = oc_baseline_node.learning:export",
            "plot = oc_baseline_node.learning:plot",
            "train = oc_baseline_node.learning:train",
            "training_figures = oc_baseline_node.learning:training_figures",
        ],
    },
)
