import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
from package_setup import setup_package

setup_package(
    {
        "console_scripts": [
            "coordinator = option_coordinator.nodes.coordinator_node:main",
            "navigation_agent = option_coordinator.nodes.navigation_agent:main",
            "evaluate = option_coordinator.training.cli.learning:evaluate",
            "evaluate_offline = option_coordinator.training.cli.learning:evaluate_offline",
            "replay = option_coordinator.cli:replay",
            "loop = option_coordinator.training.cli.learning:loop",
            "train = option_coordinator.training.cli.learning:train",
            "plot = option_coordinator.training.cli.learning:plot",
            "training_figures = option_coordinator.training.cli.learning:training_figures",
        ],
    }
)
