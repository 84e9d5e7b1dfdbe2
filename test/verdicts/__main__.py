"""Hold the verdicts of `evaluate_offline` to what policies then do, in worlds that are or are not as their file says.

python test/verdicts [--count 60] [--seed 0] [--minutes M] [--output FILE] [--kind NAME]
                       [--work FOLDER] [--write FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).parent.parent)

from verdicts.command import main  # noqa: E402  (a folder that is run, not installed)

if __name__ == "__main__":
    sys.argv[0] = str(Path(__file__).parent)  # its name in the results
    raise SystemExit(main())
