"""Drive to goals on floors where doors are closed that are open on the map, beside the best that could be known.

python test/closed_doors [--worlds 50] [--shut 20] [--seed 0] [--output FILE]
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).parent.parent)

from closed_doors.command import main  # noqa: E402  (a folder that is run, not installed)

if __name__ == "__main__":
    sys.argv[0] = str(Path(__file__).parent)  # its name in the results
    raise SystemExit(main())
