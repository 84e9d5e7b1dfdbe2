"""Progress of a run: a bar in a terminal, a few lines in a log."""

from __future__ import annotations

import math
import sys

from tqdm import tqdm

_LAYOUT = "{desc}: {percentage:3.0f}% of the way |{bar}| {postfix}"


class ProgressDisplay:
    """Shows one drive on standard error."""

    def __init__(self, title: str, lines: int) -> None:
        """Set it up.

        Args:
            title: Title of the display.
            lines: Number of lines, where no terminal shows a bar.
        """
        self._title = title
        self._lines = lines
        self._said = 0
        self._last = ""
        self._bar = tqdm(total=1.0, desc=title, bar_format=_LAYOUT) if sys.stderr.isatty() else None

    def show(self, progress: float, figures: str) -> None:
        """Show the part of the way done, 0 to 1 (NaN where the task has no path), and a few words."""
        progress = min(1.0, max(0.0, progress)) if math.isfinite(progress) else 0.0
        if self._bar is not None:
            self._bar.set_postfix_str(figures, refresh=False)
            self._bar.update(max(0.0, progress - self._bar.n))
            return
        self._last = f"{self._title}: {100 * progress:3.0f}% of the way, {figures}\n"
        if int(self._lines * progress) > self._said:
            self._said = int(self._lines * progress)
            self._say()

    def close(self) -> None:
        """Say the last word and leave the terminal as it was."""
        if self._bar is not None:
            self._bar.close()
        self._say()

    def _say(self) -> None:
        sys.stderr.write(self._last)
        sys.stderr.flush()
        self._last = ""
