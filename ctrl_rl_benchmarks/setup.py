import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
from package_setup import setup_package

setup_package(
    {
        "console_scripts": [
            "barn = ctrl_rl_benchmarks.cli.barn:barn",
            "hardness = ctrl_rl_benchmarks.cli.tasks:hardness",
            "page = ctrl_rl_benchmarks.cli.tasks:page",
            "plot = ctrl_rl_benchmarks.cli.learning:plot",
            "teach = ctrl_rl_benchmarks.cli.teaching:teach",
            "train = ctrl_rl_benchmarks.cli.learning:train",
        ],
    }
)
