"""Drive filtered robots through doors a little wider than the certificate needs, with drivers that aim off the middle.

python test/doors [--episodes 50] [--seed 0] [--robots NAME ...] [--output FILE]
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).parent.parent)

from doors.command import main  # noqa: E402  (a folder that is run, not installed)

if __name__ == "__main__":
    sys.argv[0] = str(Path(__file__).parent)  # its name in the results
    raise SystemExit(main())
