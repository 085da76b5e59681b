"""The server of the app: on 127.0.0.1 alone, for whoever has the token in its address, and for the page it gave out.

A request must name this server as its host (a name of the network that points here would be another), carry the token, and, where
it changes something, come from the page itself.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import re
import secrets
import shutil
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler, stream_request_body

from greybox.base import DataError, GreyboxError, write_file
from greybox.base.files import find_free_path
from greybox.data.experiment import GapError
from greybox.data.file_kinds import record_suffixes
from greybox.data.policy import READING_POLICY
from greybox.extensions.app.jobs import JobKind
from greybox.extensions.app.workbench import UnmatchedRecordError, Workbench
from greybox.show.printers.html import pack_plotly, page_style, read_plotly, security_policy

# The page of the app: one HTML text with style and scripts inside, and what a browser may do with it.


@cache
def page_text() -> str:
    """The page. It holds nothing of a session: that comes as data, which its script shows as text."""
    # A name that the page does not know is a mistake of ours, and stops.
    environment = Environment(
        loader=PackageLoader("greybox.extensions.app", "template"), autoescape=True, undefined=StrictUndefined
    )
    style = page_style() + _part("app.css")
    return environment.get_template("app.html").render(style=style, script=_part("app.js"), plotly=pack_plotly())


@cache
def page_policy() -> str:
    """What a browser may do: run the two scripts of the page, ask this server, and nothing else."""
    return f"{security_policy([_part('app.js'), read_plotly()])}; connect-src 'self'; frame-ancestors 'none'"


def _part(name: str) -> Markup:
    return Markup(files("greybox.extensions.app").joinpath("template", name).read_text(encoding="utf-8"))


ADDRESS = "127.0.0.1"
"""The only address that is listened on."""
FORBIDDEN, UNPROCESSABLE, FAILED = 403, 422, 500
"""Answers of HTTP."""


# Bytes of a request that is no record: values of all constants take a few thousand.
LARGEST_REQUEST = 1000000
# Random bytes of the token in the address: nobody guesses 192 bits.
TOKEN_BYTES = 24


class AppServer:
    """Serves a `Workbench` until it is closed.

    Parameters
    ----------
    workbench
        What the page works on.
    port
        Where it listens; 0 for any that is free.
    """

    def __init__(self, workbench: Workbench, port: int = 0) -> None:
        self.workbench = workbench
        self.token = secrets.token_urlsafe(TOKEN_BYTES)
        # One at a time: the session is one, and so is the person.
        self.executor = ThreadPoolExecutor(1)
        self.streams: set[asyncio.Queue] = set()
        self._loop = asyncio.get_running_loop()
        try:
            sockets = bind_sockets(port, ADDRESS)
        except OSError as error:
            raise GreyboxError(
                f"--port {port}: cannot be listened on ({error.strerror}); give another port, or leave it out"
            ) from error
        self.port: int = sockets[0].getsockname()[1]
        routes = [
            (r"/([^/]+)/", PageHandler),
            (r"/([^/]+)/state", StateHandler),
            (r"/([^/]+)/events", EventHandler),
            (r"/([^/]+)/records", UploadHandler),
            (r"/([^/]+)/do/([a-z]+)", ActionHandler),
        ]
        application = Application(
            [(pattern, handler, {"server": self}) for pattern, handler in routes],
            default_handler_class=NothingHandler,
            default_handler_args={"server": self},
            log_function=lambda _: None,
        )
        self._http = HTTPServer(application, max_body_size=LARGEST_REQUEST)
        self._http.add_sockets(sockets)
        workbench.listener = self.tell

    @property
    def address(self) -> str:
        """What a browser opens; whoever has it can use the app."""
        return f"http://{ADDRESS}:{self.port}/{self.token}/"

    def allows(self, request: HTTPServerRequest, token: str) -> bool:
        """Whether a request is from somebody who was given the address, and not from a page of another server."""
        hosts = {f"{name}:{self.port}" for name in (ADDRESS, "localhost")}
        # A name that somebody else's DNS points here is not ours (DNS rebinding).
        if request.headers.get("Host") not in hosts:
            return False
        # In a time that does not tell how much of it was right.
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return False
        origins = {f"http://{host}" for host in hosts}
        origin = request.headers.get("Origin")
        # A page of another server says so in its request; an address that is typed in sends no origin, and may only read.
        return origin in origins or (origin is None and request.method in ("GET", "HEAD"))

    def tell(self, news: Mapping[str, Any]) -> None:
        """Send news to every window of the page; called in any thread."""
        # Queues belong to the server's thread.
        self._loop.call_soon_threadsafe(self._spread, dict(news))

    def _spread(self, news: Mapping[str, Any]) -> None:
        for stream in self.streams:
            stream.put_nowait(news)

    async def compute(self, function: Callable[[], Any]) -> Any:
        """What ``function`` gives, computed beside the server, one after the other."""
        return await self._loop.run_in_executor(self.executor, function)

    async def close(self) -> None:
        """Stop listening, and what runs."""
        # First nobody new, then what runs, then the windows that listen.
        self._http.stop()
        self.workbench.close()
        for stream in self.streams:
            # Nothing more comes: the window's answer ends.
            stream.put_nowait(None)
        await self._http.close_all_connections()
        self.executor.shutdown(wait=False, cancel_futures=True)


class GuardedHandler(RequestHandler):
    """Answers only whom the server allows; everybody else gets an empty refusal."""

    def initialize(self, server: AppServer) -> None:
        """Keep the server that it answers for."""
        self.server = server

    def prepare(self) -> None:
        """Refuse whoever is not allowed, before anything of the request is looked at."""
        # Addresses without a token match no route, and are refused as well.
        token = self.path_args[0] if self.path_args else ""
        if not self.server.allows(self.request, token):
            raise HTTPError(FORBIDDEN)

    def set_default_headers(self) -> None:
        """Nothing is kept, framed, guessed or passed on by a browser."""
        # Which server it is concerns nobody.
        self.clear_header("Server")
        for name, value in {
            "Cache-Control": "no-store",
            "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
            "Cross-Origin-Opener-Policy": "same-origin",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
        }.items():
            self.set_header(name, value)

    def write_error(self, status_code: int, **_: Any) -> None:
        """An error without a word of what is inside."""
        self.finish()

    def log_exception(self, kind: Any, error: Any, trace: Any) -> None:
        """What nobody expected goes to the terminal; refusals are not spoken of."""
        if not isinstance(error, HTTPError):
            traceback.print_exception(kind, error, trace, file=sys.stderr)

    def answer(self, content: Any, status: int = 200) -> None:
        """Finish with ``content`` as JSON."""
        self.set_status(status)
        self.set_header("Content-Type", "application/json; charset=utf-8")
        self.finish(json.dumps(content, allow_nan=False, ensure_ascii=True, separators=(",", ":")))

    async def answer_with(self, function: Callable[[], Any]) -> None:
        """Finish with what ``function`` gives, or with what it refuses."""
        try:
            content = await self.server.compute(function)
        except UnmatchedRecordError as error:
            self.answer({"error": str(error), "choice": error.choice}, UNPROCESSABLE)
        except GapError as error:
            self.answer({"error": str(error), "gap": True}, UNPROCESSABLE)
        except (GreyboxError, OSError) as error:
            self.answer({"error": str(error)}, UNPROCESSABLE)
        # A bug ends this answer alone: the terminal gets all of it, the page what it is.
        except Exception as error:
            traceback.print_exc(file=sys.stderr)
            self.answer({"error": f"{type(error).__name__}: {error}"}, FAILED)
        else:
            self.answer(content)


class NothingHandler(GuardedHandler):
    """Any other address."""

    def prepare(self) -> None:
        """Refuse."""
        raise HTTPError(FORBIDDEN)


class PageHandler(GuardedHandler):
    """The page."""

    def get(self, _: str) -> None:
        """Give it, with what a browser may do for it."""
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.set_header("Content-Security-Policy", page_policy())
        self.finish(page_text())


class StateHandler(GuardedHandler):
    """The state of the session."""

    async def get(self, _: str) -> None:
        """Give it."""
        await self.answer_with(self.server.workbench.show)


# Seconds between signs of life on the stream of progress, so that a page that is gone is noticed.
HEARTBEAT_SECONDS = 15.0


class EventHandler(GuardedHandler):
    """News of what runs, as they come (server-sent events)."""

    def initialize(self, server: AppServer) -> None:
        """Begin to listen."""
        super().initialize(server)
        self.news: asyncio.Queue = asyncio.Queue()

    async def get(self, _: str) -> None:
        """Send them until the page or the server is gone."""
        self.set_header("Content-Type", "text/event-stream")
        self.server.streams.add(self.news)
        try:
            await self.flush()
            while True:
                try:
                    news = await asyncio.wait_for(self.news.get(), HEARTBEAT_SECONDS)
                except TimeoutError:
                    self.write(": still here\n\n")
                else:
                    if news is None:
                        return
                    self.write(f"data: {json.dumps(news, allow_nan=False)}\n\n")
                await self.flush()
        except OSError:  # the page is gone (tornado's StreamClosedError is an OSError)
            return
        finally:
            self.server.streams.discard(self.news)

    def on_connection_close(self) -> None:
        """End with the page."""
        self.news.put_nowait(None)


class ActionHandler(GuardedHandler):
    """What a person does: ``do/values``, ``do/effect``, ``do/fit`` ..."""

    async def post(self, _: str, name: str) -> None:
        """Do it, and answer with the new state or with what was asked for."""
        prepare = ACTIONS.get(name)
        try:
            # What is no JSON object is no request of the page.
            given = json.loads(self.request.body or b"{}")
        except ValueError:
            given = None
        if prepare is None or not isinstance(given, dict):
            raise HTTPError(FORBIDDEN)
        bench = self.server.workbench

        def act() -> Any:
            try:
                action = prepare(bench, given)
            except (KeyError, TypeError, ValueError, AttributeError) as error:
                raise DataError(f"{name}: not understood ({error}); load the page again") from error
            # An action that gives nothing has changed the session.
            result = action()
            return bench.show() if result is None else result

        await self.answer_with(act)


def _values(given: Mapping[str, Any]) -> dict[str, float]:
    values = given["values"]
    for value in values.values():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"{value!r} is not a number")
    return {str(name): float(value) for name, value in values.items()}


ACTIONS: Mapping[str, Callable[[Workbench, Mapping[str, Any]], Callable[[], Any]]] = {
    "preview": lambda bench, given: partial(bench.show_run, int(given["record"]), _values(given)),
    "run": lambda bench, given: partial(bench.show_run, int(given["record"]), inputs=True),
    "locate": lambda bench, given: partial(bench.show_location, int(given["record"])),
    "values": lambda bench, given: partial(bench.set_values, _values(given)),
    "fixed": lambda bench, given: partial(bench.set_fixed, str(given["name"]), bool(given["fixed"])),
    "effect": lambda bench, given: partial(
        bench.add_effect if given["on"] else bench.remove_effect, str(given["name"])
    ),
    "part": lambda bench, given: partial(bench.set_part, str(given["name"]), str(given["known"])),
    "forget": lambda bench, given: partial(bench.forget, int(given["record"])),
    "role": lambda bench, given: partial(bench.set_role, int(given["record"]), bool(given["validates"])),
    "split": lambda bench, given: bench.split,
    "undo": lambda bench, given: bench.undo,
    "fit": lambda bench, given: partial(bench.start, JobKind.FIT),
    "discover": lambda bench, given: partial(bench.start, JobKind.DISCOVER),
    "stop": lambda bench, given: bench.stop,
    "export": lambda bench, given: lambda: {"files": list(map(str, bench.export())), "folder": str(bench.folder)},
}
"""What a page can ask for, by its name, as a call to make; one that gives nothing is answered with the new state."""


@stream_request_body
class UploadHandler(GuardedHandler):
    """A record that a person loads in the page: its bytes, with ``name``, ``validates`` and ``columns`` in the address."""

    def initialize(self, server: AppServer) -> None:
        """Nothing is open yet."""
        super().initialize(server)
        self.opened = ExitStack()

    def prepare(self) -> None:
        """Refuse whoever is not allowed; then take as much as the readers take."""
        super().prepare()
        if self.request.method != "POST":
            raise HTTPError(FORBIDDEN)
        # On the disk without a name: a record may be larger than the memory.
        self.received = self.opened.enter_context(tempfile.TemporaryFile())  # noqa: SIM115 (closed in on_finish)
        # As much as a reader would take; every other request is small.
        self.request.connection.set_max_body_size(READING_POLICY.largest_file)  # type: ignore[union-attr]

    def data_received(self, chunk: bytes) -> None:
        """Keep a piece on the disk."""
        self.received.write(chunk)

    def on_finish(self) -> None:
        """Let go of the bytes."""
        self.opened.close()

    async def post(self, _: str) -> None:
        """Read it, and answer with the new state."""
        name, validates = self.get_query_argument("name", ""), self.get_query_argument("validates", "") == "1"

        def load() -> Any:
            bench = self.server.workbench
            # Which column is which signal, as a person said it in the page.
            try:
                columns = json.loads(self.get_query_argument("columns", "{}"))
            except ValueError:
                columns = None
            if not isinstance(columns, dict) or not all(isinstance(column, str) for column in columns.values()):
                raise DataError("columns: not understood; load the page again")
            file = self._store(bench.uploads, name)
            try:
                bench.load(file, validates=validates, columns=columns)
            except BaseException:  # raised again: what could not be read is not kept
                file.unlink(missing_ok=True)
                raise
            return bench.show()

        await self.answer_with(load)

    def _store(self, folder: Path | None, name: str) -> Path:
        """The bytes as a file in the folder for uploads, under a name that is safe and new there."""
        # Letters, digits and a few marks of the last part of the name: no path, nothing that a shell or a disk reads otherwise.
        safe = re.sub(r"[^\w .()+-]", "_", Path(name.replace("\\", "/")).name).strip(". ")
        file = Path(safe)
        if folder is None or not file.stem or file.suffix.lower() not in record_suffixes():
            raise DataError(
                f"{name or 'record'}: no kind of record; load a file that ends in {', '.join(sorted(record_suffixes()))}"
            )
        self.received.seek(0)
        # A file of the same name is another record.
        return write_file(find_free_path(folder / file.name), partial(shutil.copyfileobj, self.received), private=True)


async def serve(workbench: Workbench, port: int, ready: Callable[[str], None]) -> None:
    """Serve until it is cancelled or interrupted; ``ready`` is called with the address."""
    server, ended = AppServer(workbench, port), asyncio.Event()
    if threading.current_thread() is threading.main_thread() and sys.platform != "win32":
        # Heard by the loop itself: what a handler raises inside an answer, or while an object is deleted, is lost.
        asyncio.get_running_loop().add_signal_handler(signal.SIGINT, ended.set)
    try:
        ready(server.address)
        await ended.wait()
    finally:
        await server.close()
