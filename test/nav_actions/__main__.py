"""Send the navigator goals as a client of Nav2 does, and follow paths by several drivers beside a dynamic window.

python test/nav_actions [--goals 50] [--paths 50] [--seed 0] [--drivers NAME ...] [--output FILE]
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).parent.parent)

from nav_actions.command import main  # noqa: E402  (a folder that is run, not installed)

if __name__ == "__main__":
    sys.argv[0] = str(Path(__file__).parent)  # its name in the results
    raise SystemExit(main())
