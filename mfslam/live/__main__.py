"""The back end's process."""

from __future__ import annotations

import sys

from mfslam.live.back_end import main

if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
