import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
from package_setup import setup_package

setup_package(
    {
        "console_scripts": [
            "evaluate = ctrl_rl_learning.cli.evaluate:evaluate",
            "evaluate_offline = ctrl_rl_learning.cli.evaluate_offline:evaluate_offline",
            "export = ctrl_rl_learning.cli.export:export",
            "fine_tune = ctrl_rl_learning.cli.fine_tune:fine_tune",
            "improve = ctrl_rl_learning.cli.improve:improve",
            "learn_offline = ctrl_rl_learning.cli.learn_offline:learn_offline",
            "teach = ctrl_rl_learning.cli.teach:teach",
        ],
    }
)
