"""The program ``getagrip``, also ``python -m getagrip``."""

import gc
import sys

from getagrip.io import processes

OBJECTS_PER_COLLECTION = 20_000
"""Number of new objects after which garbage is collected. By Python's default, 700, walks over the many lasting objects
of the libraries take a twentieth of a command's time."""


def main() -> int:
    """Run the command line. Returns the exit status, also of an interrupt."""
    gc.set_threshold(OBJECTS_PER_COLLECTION)
    processes.exit_on_interrupt()
    try:
        from getagrip import cli

        status = cli.main()
    except BaseException as error:
        if not isinstance(error, KeyboardInterrupt) and not processes.interrupt_count():
            raise
        print("interrupted", file=sys.stderr)
        status = processes.INTERRUPT_EXIT_STATUS
    if status == processes.INTERRUPT_EXIT_STATUS and processes.is_program():
        processes.restore_default_interrupt()
    return status


if __name__ == "__main__":
    sys.exit(main())
