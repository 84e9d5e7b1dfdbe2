from setuptools import setup

NAME = "oc_baseline_node"

setup(
    name=NAME,
    version="0.1.0",
    description="Optimal-control return-to-go as a policy-gradient baseline (thesis 3.3).",
    license="Apache-2.0",
    packages=[NAME, f"{NAME}.training"],
    package_data={"oc_baseline_node": ["py.typed", "values/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "analyse = oc_baseline_node.training.analysis_cli:main",
            "baseline = oc_baseline_node.node:main",
            "oc = oc_baseline_node.cli:main",
            "train = oc_baseline_node.training.training_cli:train",
            "training_figures = oc_baseline_node.training.training_cli:training_figures",
        ],
    },
)
