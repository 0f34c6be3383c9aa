"""Run code in a Python without what Windows lacks: modules, sockets, signals, functions of ``os``.

``python -m tests.portability.without_posix SCRIPT`` runs a script that way. Paths keep their
slashes, and the standard library may still fork: only names that a program can use are removed.
"""

import importlib
import os
import runpy
import signal
import socket
import sys
from functools import partial

MODULES = {"fcntl", "termios", "tty", "pty", "pwd", "grp", "resource", "syslog", "readline"}
SIGNALS = [
    name for name in dir(signal)
    if name.startswith("SIG") and name not in
    ("SIGABRT", "SIGFPE", "SIGILL", "SIGINT", "SIGSEGV", "SIGTERM", "SIG_DFL", "SIG_IGN")
]  # fmt: skip
SIGNAL_CALLS = ("alarm", "setitimer", "getitimer", "siginterrupt", "pthread_sigmask", "sigwait")
OS_NAMES = (
    "fork", "forkpty", "register_at_fork", "getuid", "geteuid", "getgid", "setsid", "getpgid",
    "getpgrp", "killpg", "openpty", "ttyname", "pread", "pwrite", "fchmod", "fchown", "chown",
    "sched_setscheduler", "sched_setaffinity", "sched_getaffinity", "nice", "uname", "getloadavg",
    "O_NOFOLLOW", "O_CLOEXEC", "O_NONBLOCK", "O_DIRECTORY", "O_NOCTTY",
)  # fmt: skip

OTHERS = (
    "multiprocessing", "subprocess", "tempfile", "asyncio", "concurrent.futures.thread", "platform",
    "webbrowser", "numpy", "scipy.interpolate", "scipy.spatial", "scipy.optimize", "serial",
    "serial.tools.list_ports", "typer", "rich.live", "uvicorn", "starlette", "websockets", "ruckig",
    "platformdirs",
)  # fmt: skip


def remove_posix():
    """Remove everything that Windows lacks, from here on."""
    socket.socketpair = partial(socket.socketpair, socket.AF_UNIX)  # Windows has one of its own
    sys.modules.update(dict.fromkeys(MODULES))  # None means that there is no such module
    for module, names in ((socket, ("AF_UNIX",)), (signal, (*SIGNALS, *SIGNAL_CALLS))):
        for name in names:
            if hasattr(module, name):
                delattr(module, name)
    for name in OS_NAMES:
        if hasattr(os, name):
            delattr(os, name)


if __name__ == "__main__":
    for library in OTHERS:  # they have forms of their own for Windows
        importlib.import_module(library)
    remove_posix()
    runpy.run_path(sys.argv[1], run_name="__main__")
