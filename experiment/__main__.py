"""`palpate`, and `python -m palpate.experiment`: from the first import on, Ctrl-C is one line and exit code 130."""

import os
import sys

if __name__ == "__main__" and not sys.flags.safe_path and os.path.isdir(sys.path[0]):  # noqa: PTH112
    # `-m` has put the working folder first, unless that was deleted; a lab's own random.py may be there.
    del sys.path[0]

OVERVIEWS: tuple[list[str], ...] = ([], ["-h"], ["--help"])
"""What is typed for the list of commands; a shell that completes a command types nothing, too."""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from sys import UnraisableHookArgs


def _unraisable(told: "UnraisableHookArgs") -> None:
    """Bring back an interrupt from a callback that cannot raise it, as in the middle of an import."""
    if told.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(told)
        return
    import signal
    import threading

    # Not from here: this would be lost as the first one was.
    again = threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT))
    again.daemon = True
    again.start()


def main() -> None:
    """Entry point of the command."""
    before, sys.unraisablehook = sys.unraisablehook, _unraisable
    try:
        import atexit
        import gc
        import io

        for stream in (sys.stdout, sys.stderr):
            # A pipe on Windows has a code page, which holds few letters: the others leave as their codes.
            if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
                stream.reconfigure(errors="backslashreplace")
        # For workers that libraries start, too; the parts of palpate are started by `storage.python_command`.
        os.environ["PYTHONSAFEPATH"] = "1"
        # Threads of linear algebra gain nothing with matrices of a study's size, and spin while they wait.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        # pandas would import what it can, a tenth of a second, and nothing here is computed by either.
        for absent in ("pyarrow", "numexpr"):
            sys.modules.setdefault(absent, None)  # type: ignore[arg-type]
        # Little of what modules and tables hold ever becomes garbage, and searching it takes time.
        gc.set_threshold(20_000)
        # The system frees what is left at once; searching it for garbage takes a tenth of a second.
        atexit.register(gc.freeze)
        if sys.stdout is not None and sys.argv[1:] in OVERVIEWS and "_PALPATE_COMPLETE" not in os.environ:
            from palpate.experiment.cli import opens_desk, overview

            if sys.argv[1:] or not opens_desk():
                sys.stdout.write(overview())
                return
            sys.argv.append("desk")
        from palpate.experiment.cli.app import main as command

        command()
    except (Exception, KeyboardInterrupt) as error:
        from palpate.experiment.cli import tell, was_interrupted

        if not was_interrupted(error):
            raise
        tell("palpate: interrupted; run the same command to continue or to begin again")
        # An interrupt that passed through code made from text, as of data classes, is forgotten by the next such code:
        # otherwise Python ends with the signal and not with the exit code.
        eval("None")  # noqa: S307
        raise SystemExit(130) from None
    finally:
        import signal

        # What is done is done: while Python ends, an interrupt changes nothing.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        sys.unraisablehook = before


if __name__ == "__main__":
    main()
