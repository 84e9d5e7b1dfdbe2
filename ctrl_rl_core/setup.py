import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
from package_setup import setup_package

setup_package(
    {
        "console_scripts": [
            "bag = ctrl_rl_core.moved:bag",
            "policy = ctrl_rl_core.policies.policy_node:main",
            "recorder = ctrl_rl_core.moved:recorder",
            "thrust_watchdog = ctrl_rl_core.driving.thrust_watchdog_node:main",
            "watchdog = ctrl_rl_core.driving.watchdog_node:main",
        ],
        "ctrl_rl.policies": [
            "actor = ctrl_rl_core.policies.actor_policy:KIND",
            "onnx = ctrl_rl_core.policies.onnx_policy:KIND",
        ],
    }
)
