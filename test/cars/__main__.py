"""Drive cars to goals with a heading on three maps, and plan the same drives by a hybrid A*.

python test/cars [--maps office maze parking] [--engines planar] [--goals 100] [--seed 0] [--output FILE]
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).parent.parent)

from cars.command import main  # noqa: E402  (a folder that is run, not installed)

if __name__ == "__main__":
    sys.argv[0] = str(Path(__file__).parent)  # its name in the results
    raise SystemExit(main())
