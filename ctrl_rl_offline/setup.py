import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
from package_setup import setup_package

setup_package(
    {
        "console_scripts": [
            "correlation = ctrl_rl_offline.cli.correlation:correlation",
            "evaluate_offline = ctrl_rl_offline.cli.evaluate:evaluate_offline",
            "learn_offline = ctrl_rl_offline.cli.learn:learn_offline",
            "loop = ctrl_rl_offline.cli.loop:loop",
        ],
    }
)
