"""Launching the console: arguments, the port, the address to open; what can go wrong is said in one sentence."""

from __future__ import annotations

import argparse
import errno
import importlib.util
import logging
import secrets
import socket
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from cathsim.console.operator_setup import NO_CATHETER
from cathsim.console.recorder import Recorder, find_recorder
from cathsim.console.web.messages import Access, is_loopback
from cathsim.metrics import FORCE_LIMIT

EXIT_FAILED, EXIT_USAGE = 1, 2
EXTRA = {"fastapi": "fastapi", "uvicorn": "uvicorn", "websockets": "websockets"}
_LARGEST_MESSAGE = 65_536  # bytes that a page may send at once


class LaunchError(Exception):
    """The console cannot start; the message is one sentence."""


class Parser(argparse.ArgumentParser):
    """Refuses wrong arguments in one line, without the list of all of them."""

    def error(self, message: str) -> NoReturn:
        """Ends the program with exit code 2."""
        self.exit(EXIT_USAGE, f"{self.prog}: {message} (--help lists what there is)\n")


def parser(prog: str, *, folder: Path | None) -> argparse.ArgumentParser:
    """The command line; `folder` is where episodes go by default, None where the program chooses it by other means."""
    arguments = Parser(
        prog=prog, description="Steer a guidewire, or a wire in a catheter, in the browser: keyboard, gamepad or touch."
    )
    add = arguments.add_argument
    add("--phantom", default="type_1", help="phantom to begin with (default %(default)s)")
    add("--target", default="bca", help="target to begin with (default %(default)s)")
    add("--wire", default="default", help="guidewire (default %(default)s)")
    add(
        "--catheter",
        default=NO_CATHETER,
        help="catheter to begin with: of the shelf (vertebral, simmons2_6f) or a YAML file (default %(default)s)",
    )
    add("--max-steps", type=int, default=300, help="control steps of 0.1 s in a procedure (default %(default)s)")
    add(
        "--success-radius-mm",
        type=float,
        default=8.0,
        help="the target is reached within this distance of the tip (default %(default)s)",
    )
    add(
        "--force-limit",
        type=float,
        default=FORCE_LIMIT,
        help="contact force in N at which the page warns, and counts it (default %(default)s)",
    )
    add("--end-at-force-limit", action="store_true", help="the procedure ends at the force limit")
    add("--seed", type=int, default=0, help="of the first procedure's start; each further one has the next")
    add("--host", default="127.0.0.1", help="address to listen on; other than this machine's own needs a token")
    add("--port", type=int, default=8000, help="port (default %(default)s; 0 takes a free one)")
    add("--token", help="that the address must carry; made up for an open --host when it is not given")
    if folder is not None:
        add("--record", type=Path, default=folder, metavar="FOLDER", help="where episodes go (default %(default)s)")
    add("--no-expert", action="store_true", help="do not compute the sampling expert's score beside the procedure")
    add("--no-record", action="store_true", help="keep no episodes")
    return arguments


def listen(host: str, port: int) -> socket.socket:
    """Takes a port before anything slow is done; 0 takes a free one. Returns the bound socket.

    Raises:
        LaunchError: it is in use, not allowed, or the address is not this machine's.
    """
    if not 0 <= port <= 65_535:
        raise LaunchError(f"--port must lie in 0 to 65535, got {port}")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        taken = socket.socket(family, kind, protocol)
    except (OSError, UnicodeError) as error:
        raise LaunchError(f"--host {host} is no address of this machine: {error}") from error
    try:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.bind(address)
        taken.listen()  # only a listening socket keeps a second console from binding as well
    except OSError as error:
        taken.close()
        if error.errno == errno.EADDRINUSE:
            raise LaunchError(
                f"port {port} on {host} is in use, perhaps by another console: close that, or choose another --port"
            ) from error
        raise LaunchError(f"cannot listen on {host}, port {port}: {error.strerror}") from error
    return taken


def missing_extra() -> list[str]:
    """Distributions of the extra `console` that are not installed."""
    return [name for module, name in EXTRA.items() if importlib.util.find_spec(module) is None]


def address_of(host: str, port: int, token: str | None) -> str:
    """The address that the operator opens."""
    host_name = socket.gethostname() if host in ("0.0.0.0", "::", "") else host
    return f"http://{f'[{host_name}]' if ':' in host_name else host_name}:{port}/{f'?token={token}' if token else ''}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the console until Ctrl-C; returns the exit code."""
    factory = find_recorder()
    options = parser("python -m cathsim.console", folder=factory.default_folder).parse_args(arguments)
    return start(options, factory, options.record)


def start(options: argparse.Namespace, factory: Any, folder: Path) -> int:
    """Runs the console with options of `parser`: 0, or 1 with one sentence on the standard error.

    Args:
        factory: makes a recorder of a folder.
        folder: where episodes go.
    """
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(message)s")
    try:
        if missing := missing_extra():
            raise LaunchError(f"the console needs {', '.join(missing)}: pip install 'endonav-cathsim[console]'")
        with listen(options.host, options.port) as taken:
            recorder = None if options.no_record else _recorder(factory, folder)
            _serve(options, taken, recorder, folder)
    except LaunchError as error:
        sys.stderr.write(f"{error}\n")
        return EXIT_FAILED
    except KeyboardInterrupt:
        pass  # the usual way to end it
    return 0


def _recorder(factory: Any, folder: Path) -> Recorder:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LaunchError(f"episodes cannot go to {folder}: {error.strerror}; name another folder") from error
    return factory(folder)


def _serve(options: argparse.Namespace, taken: socket.socket, recorder: Recorder | None, folder: Path) -> None:
    import uvicorn

    from cathsim.console.operator_setup import ForceLimit, Setup
    from cathsim.console.web.server import Desk, create_app
    from cathsim.console.worker import RealTimeLoop

    open_to_others = not is_loopback(options.host)
    token = options.token or (secrets.token_urlsafe(16) if open_to_others else None)
    desk = Desk()
    try:
        setup = Setup(
            options.phantom,
            options.target,
            options.wire,
            None if options.catheter == NO_CATHETER else options.catheter,
            max_steps=options.max_steps,
            seed=options.seed,
            success_radius=options.success_radius_mm * 1e-3,
            force_limit=ForceLimit(options.force_limit, options.end_at_force_limit),
        )
        loop = RealTimeLoop(setup, desk, recorder, note=str(folder), compared=not options.no_expert)
    except ValueError as error:
        raise LaunchError(str(error)) from error
    port = taken.getsockname()[1]
    sys.stdout.write(f"console: {address_of(options.host, port, token)}  (Ctrl-C ends it)\n")
    sys.stdout.write(f"episodes: {folder if recorder else 'not kept'}\n")
    sys.stdout.flush()
    config = uvicorn.Config(
        create_app(loop, desk, Access(token)),
        log_level="warning",
        access_log=False,  # its lines would hold the token
        ws_max_size=_LARGEST_MESSAGE,
        ws_per_message_deflate=False,  # pictures do not compress further
        timeout_graceful_shutdown=1,
    )
    uvicorn.Server(config).run(sockets=[taken])
