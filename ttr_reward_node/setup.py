from setuptools import setup

NAME = "ttr_reward_node"

setup(
    name=NAME,
    version="0.1.0",
    description="Time-to-reach rewards from Hamilton-Jacobi value functions (thesis 3.2).",
    license="Apache-2.0",
    packages=[NAME],
    package_data={"ttr_reward_node": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=False,
)
