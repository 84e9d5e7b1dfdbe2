import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
from package_setup import setup_package

setup_package(
    {
        "console_scripts": [
            "analyse = koopman_lqr_controller.cli.analyse:analyse",
            "compare = koopman_lqr_controller.cli.compare:compare",
            "comparison_figures = koopman_lqr_controller.cli.compare:comparison_figures",
            "consolidate = koopman_lqr_controller.cli.learn:consolidate",
            "controller = koopman_lqr_controller.nodes.controller_node:main",
            "edmd = koopman_lqr_controller.cli.edmd:main",
            "evaluate = koopman_lqr_controller.cli.offline:evaluate",
            "fit = koopman_lqr_controller.cli.offline:fit",
            "learn = koopman_lqr_controller.cli.learn:learn",
            "learn_offline = koopman_lqr_controller.cli.offline:learn_offline",
            "plot = koopman_lqr_controller.cli.compare:plot",
            "scripted_driver = koopman_lqr_controller.nodes.scripted_driver_node:main",
            "train = koopman_lqr_controller.cli.train:train",
        ],
        "ctrl_rl.policies": ["policy = koopman_lqr_controller.policies.driving:KIND"],
    }
)
