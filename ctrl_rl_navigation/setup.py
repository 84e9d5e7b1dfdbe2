import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
from package_setup import setup_package

setup_package(
    {
        "console_scripts": [
            "navigator = ctrl_rl_navigation.nodes.navigator_node:main",
            "map_server = ctrl_rl_navigation.nodes.map_node:main",
            "trials = ctrl_rl_navigation.cli.trials:main",
        ],
    }
)
