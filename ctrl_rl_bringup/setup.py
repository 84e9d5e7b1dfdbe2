import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
from package_setup import setup_package

setup_package(
    {
        "console_scripts": [
            "animate = ctrl_rl_bringup.cli.animate:animate",
            "compile = ctrl_rl_bringup.cli.compile:compile_kernels",
            "demo = ctrl_rl_bringup.cli.drive:demo",
            "export = ctrl_rl_bringup.cli.export:export",
            "monitor = ctrl_rl_bringup.cli.drive:monitor",
            "options_demo = ctrl_rl_bringup.cli.team:demo",
            "options_monitor = ctrl_rl_bringup.cli.team:monitor",
            "options_report = ctrl_rl_bringup.cli.team:report",
            "preflight = ctrl_rl_bringup.cli.preflight:preflight",
            "record_drives = ctrl_rl_bringup.cli.drive:record_drives",
            "report = ctrl_rl_bringup.cli.drive:report",
            "results = ctrl_rl_bringup.cli.drive:results",
            "stack = ctrl_rl_bringup.cli.stack:stack",
            "transfer = ctrl_rl_bringup.cli.transfer:transfer",
            "trials = ctrl_rl_bringup.cli.drive:trials",
            "view = ctrl_rl_bringup.view.view_node:main",
        ],
    }
)
