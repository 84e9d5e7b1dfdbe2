"""Count contacts of filtered robots with thin poles while the lidar loses beams, and the time that caution costs.

python test/missing_echoes [--episodes 100] [--seed 0] [--robots NAME ...] [--output FILE]
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).parent.parent)

from missing_echoes.command import main  # noqa: E402  (a folder that is run, not installed)

if __name__ == "__main__":
    sys.argv[0] = str(Path(__file__).parent)  # its name in the results
    raise SystemExit(main())
