from setuptools import find_packages, setup

NAME = "ctrl_rl_core"

setup(
    name=NAME,
    version="0.1.0",
    description="What every package shares: system models, tasks, value grids, files, the base of the nodes.",
    license="Apache-2.0",
    maintainer="Seed 5ee16a79 maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-5ee16a79.example",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "*.pyi", "robots/*.yaml", "tasks/task_files/*.yaml", "policies/pretrained/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
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
    },
)
