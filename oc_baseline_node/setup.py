import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
from package_setup import setup_package

setup_package(
    {
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
    }
)
