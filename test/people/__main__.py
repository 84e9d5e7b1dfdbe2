"""Count contacts with people who cross, come, follow, stand and walk in groups, and how often the navigator arrives.

python test/people [--drives 40] [--seed 0] [--filters off on] [--output FILE]
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).parent.parent)

from people.command import main  # noqa: E402  (a folder that is run, not installed)

if __name__ == "__main__":
    sys.argv[0] = str(Path(__file__).parent)  # its name in the results
    raise SystemExit(main())
