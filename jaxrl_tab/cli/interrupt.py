"""Ctrl-C that is heard at once, also while compiled code runs."""

import contextlib
import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator

PATIENCE = 3.0  # seconds
CODE = 130  # of a process that ended by Ctrl-C


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Inside, Ctrl-C and SIGTERM are a KeyboardInterrupt; a second of them ends the process at once.

    Python hears a signal only between two of its own steps, so that compiled code would be waited for. Where
    that lasts longer than `PATIENCE`, the process ends without: nobody may rely on cleaning up, only on files
    that are whole or not there. In a thread other than the main one nothing is done.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard = threading.Event()

    def interrupt(*_: object) -> None:
        heard.set()
        raise KeyboardInterrupt

    signals = [signal.SIGINT, signal.SIGTERM]
    before = {number: signal.signal(number, interrupt) for number in signals}
    ours, theirs = socket.socketpair()  # the system writes the number of each signal into it, whatever runs
    theirs.setblocking(False)
    wakeup = signal.set_wakeup_fd(theirs.fileno(), warn_on_full_buffer=False)
    watcher = threading.Thread(target=_watch, args=(ours, heard), daemon=True)
    watcher.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(wakeup)
        for number, handler in before.items():
            signal.signal(number, handler)
        theirs.close()  # which ends the watcher
        watcher.join()
        ours.close()


def _watch(signals: socket.socket, heard: threading.Event) -> None:
    """Ends the process at the second signal, or where the first is not heard in time."""
    if not _next(signals):
        return
    if not heard.wait(PATIENCE):
        _quit("interrupted; what is finished is kept")
    if _next(signals):
        _quit("interrupted twice; what is finished is kept")


def _next(signals: socket.socket) -> bool:
    """Waits for the next signal that interrupts; False when the socket is closed, so that none will come."""
    while byte := signals.recv(1):
        if byte[0] in (signal.SIGINT, signal.SIGTERM):
            return True
    return False


def _quit(what: str) -> None:
    print(f"\njaxrl-tab: {what}", file=sys.stderr, flush=True)
    os._exit(CODE)
