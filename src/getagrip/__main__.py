"""The program ``getagrip``, also ``python -m getagrip``."""

import sys

from getagrip.io import interrupts


def main() -> int:
    """Run the command line. Returns the exit status, also of an interrupt."""
    interrupts.exit_on_interrupt()
    try:
        from getagrip import cli

        status = cli.main()
    except BaseException as error:
        if not isinstance(error, KeyboardInterrupt) and not interrupts.interrupt_count():
            raise
        print("interrupted", file=sys.stderr)
        status = interrupts.INTERRUPT_EXIT_STATUS
    if status == interrupts.INTERRUPT_EXIT_STATUS and interrupts.is_program():
        interrupts.restore_default_interrupt()
    return status


if __name__ == "__main__":
    sys.exit(main())
