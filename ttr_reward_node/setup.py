import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
from package_setup import setup_package

setup_package(
    {
        "console_scripts": [
            "check = ttr_reward_node.cli.values:check",
            "relabel = ttr_reward_node.cli.values:relabel_bag",
            "reward = ttr_reward_node.nodes.reward_node:main",
            "slices = ttr_reward_node.cli.values:slices",
            "solve = ttr_reward_node.cli.values:solve_value",
            "ttr_experiments = ttr_reward_node.cli.experiments:main",
            "evaluate = ctrl_rl_learning.cli.evaluate:evaluate",
            "export = ctrl_rl_learning.cli.export:export",
            "plot = ttr_reward_node.training.cli:plot",
            "train = ttr_reward_node.training.cli:train",
            "training_figures = ttr_reward_node.training.cli:training_figures",
        ],
    }
)
