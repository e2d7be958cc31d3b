"""The program ``getagrip``, also ``python -m getagrip``."""

import sys


def main() -> int:
    """Run the command line. Returns the exit status, also of an interrupt while modules load."""
    try:
        from getagrip import cli

        return cli.main()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
