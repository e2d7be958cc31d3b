"""The program ``getagrip``, also ``python -m getagrip``."""

import sys

from getagrip.io import interrupts


def main() -> int:
    """Run the command line. Returns the exit status, also of an interrupt."""
    interrupts.while_loading()
    try:
        from getagrip import cli

        status = cli.main()
    except BaseException as error:
        if not isinstance(error, KeyboardInterrupt) and not interrupts.times():
            raise
        print("interrupted", file=sys.stderr)
        status = interrupts.STATUS
    if status == interrupts.STATUS and interrupts.is_program():
        interrupts.while_ending()
    return status


if __name__ == "__main__":
    sys.exit(main())
