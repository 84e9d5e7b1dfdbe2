"""Count contacts of filtered robots that are worse than their models, with and without the monitor of the model.

python test/wrong_model [--episodes 50] [--seed 0] [--robots NAME ...] [--output FILE]
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).parent.parent)

from wrong_model.command import main  # noqa: E402  (a folder that is run, not installed)

if __name__ == "__main__":
    sys.argv[0] = str(Path(__file__).parent)  # its name in the results
    raise SystemExit(main())
