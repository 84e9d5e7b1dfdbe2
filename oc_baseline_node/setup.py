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
            "evaluate = ctrl_rl_learning.cli.evaluate:evaluate",
            "export = ctrl_rl_learning.cli.export:export",
            "plot = oc_baseline_node.training.cli:plot",
            "train = oc_baseline_node.training.cli:train",
            "training_figures = oc_baseline_node.training.cli:training_figures",
        ],
    }
)
