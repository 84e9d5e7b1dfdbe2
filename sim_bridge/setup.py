import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
from package_setup import setup_package

setup_package(
    {
        "console_scripts": [
            "bridge = sim_bridge.ros.bridge_node:main",
        ],
    }
)
