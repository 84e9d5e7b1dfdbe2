"""Hold the time-to-reach solver to independent solutions of random systems.

python test/referee [--count 200] [--seed 0] [--family NAME] [--jobs 1] [--output FILE] [--only SEED]
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).parent.parent)

from referee.command import main  # noqa: E402  (a folder that is run, not installed)

if __name__ == "__main__":
    sys.argv[0] = str(Path(__file__).parent)  # its name in the results
    raise SystemExit(main())
