"""Simulated robots, in PyBullet or MuJoCo: Gymnasium environments, and a node in place of the robot's drivers."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
