import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
from package_setup import setup_package

setup_package(
    {
        "console_scripts": [
            "barn = ctrl_rl_trials.cli.barn:barn",
            "correlation = ctrl_rl_trials.cli.correlation:correlation",
            "hardness = ctrl_rl_trials.cli.tasks:hardness",
            "loop = ctrl_rl_trials.cli.loop:loop",
            "page = ctrl_rl_trials.cli.tasks:page",
            "plot = ctrl_rl_trials.cli.learning:plot",
            "shift_study = ctrl_rl_trials.cli.shift_study:shift_study",
            "train = ctrl_rl_trials.cli.learning:train",
        ],
    }
)
