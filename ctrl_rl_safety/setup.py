import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
from package_setup import setup_package

setup_package(
    {
        "console_scripts": [
            "safety_filter = ctrl_rl_safety.nodes.safety_filter_node:main",
            "flight_guard = ctrl_rl_safety.nodes.flight_guard_node:main",
            "identify = ctrl_rl_safety.cli.identify:main",
            "train = ctrl_rl_safety.training.command:train",
            "trials = ctrl_rl_safety.trials.command:main",
        ],
    }
)
