import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
from package_setup import setup_package

setup_package(
    {
        "console_scripts": [
            "fine_tune = ctrl_rl_robot.cli.fine_tune:fine_tune",
            "shift_study = ctrl_rl_robot.cli.shift_study:shift_study",
        ],
    }
)
