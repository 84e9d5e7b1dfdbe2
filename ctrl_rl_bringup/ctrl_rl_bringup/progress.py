"""How far a robot is: a bar in a terminal, a line at each tenth of the way in a log."""

from __future__ import annotations

import math
import sys

from tqdm import tqdm

_LAYOUT = "{desc}: {percentage:3.0f}% of the way |{bar}| {postfix}"


class ProgressDisplay:
    """Shows one drive on standard error."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._tenth = -1
        self._bar = tqdm(total=1.0, desc=title, bar_format=_LAYOUT) if sys.stderr.isatty() else None

    def show(self, progress: float, figures: str) -> None:
        """Show the part of the way done, 0 to 1 (NaN where the task has no path), and a few words."""
        progress = min(1.0, max(0.0, progress)) if math.isfinite(progress) else 0.0
        if self._bar is not None:
            self._bar.set_postfix_str(figures, refresh=False)
            self._bar.update(max(0.0, progress - self._bar.n))
        elif int(10 * progress) > self._tenth:
            self._tenth = int(10 * progress)
            sys.stderr.write(f"{self._title}: {100 * progress:3.0f}% of the way, {figures}\n")
            sys.stderr.flush()

    def close(self) -> None:
        """Leave the terminal as it was."""
        if self._bar is not None:
            self._bar.close()
