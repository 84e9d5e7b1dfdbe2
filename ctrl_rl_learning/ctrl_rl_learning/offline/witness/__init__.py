"""The bag as a witness against the task: walls, movers, poses, speeds and commands that its file does not tell."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
