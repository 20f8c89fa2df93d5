"""``python -m jaxlangnav`` is the command line."""

import sys

from jaxlangnav.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
