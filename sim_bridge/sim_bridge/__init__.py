"""Simulated robots in PyBullet, MuJoCo or the plane: Gymnasium environments, and a node in place of robot drivers."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
