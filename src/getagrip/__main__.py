"""``python -m getagrip``."""

import sys

from getagrip.cli import main

if __name__ == "__main__":
    sys.exit(main())
