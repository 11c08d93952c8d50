"""The program: `activefail`, and `python -m activefail`."""

import os
import signal
import sys


def program() -> None:
    """Load and run the command line; Ctrl-C while it is being loaded ends the process."""
    if sys.platform == "win32":
        sys.exit("activefail runs on Linux and macOS; on Windows, run it in WSL.")
    # In the background, a shell has programs ignore Ctrl-C.
    heeds_ctrl_c = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if heeds_ctrl_c:
        signal.signal(signal.SIGINT, _end)
    from activefail.cli import program as command_line

    if heeds_ctrl_c:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    command_line()


def _end(number: int, frame: object) -> None:
    # Nothing has been done yet. An exception could be lost, or become another one, in a library that is being imported.
    os.write(2, b"activefail: stopped\n")
    os._exit(130)  # `INTERRUPTED`, whose module is not loaded yet


if __name__ == "__main__":
    program()
