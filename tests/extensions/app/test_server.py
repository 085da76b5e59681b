"""What the server answers, and whom it refuses: spoken to directly, without a browser."""

from __future__ import annotations

import asyncio
import http.client
import json
import socket
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from greybox.extensions.app.command import StudyOnFile
from greybox.extensions.app.server import page_policy, page_text
from greybox.extensions.app.session import Session
from greybox.extensions.app.workbench import Workbench
from greybox.shell.commands import app
from greybox.shell.inputs import build_model
from greybox.shell.study import Study
from tests.support.command import CliRunner

pytest.importorskip("tornado", reason="the app's server is not installed")
from greybox.extensions.app.server import AppServer


class Served:
    """A server that runs in a thread, and requests to it."""

    def __init__(self, bench: Workbench) -> None:
        self.bench, self.started = bench, threading.Event()
        self.thread = threading.Thread(target=lambda: asyncio.run(self._run()))
        self.thread.start()
        assert self.started.wait(30)

    async def _run(self) -> None:
        self.server, self.loop, self.ended = AppServer(self.bench), asyncio.get_running_loop(), asyncio.Event()
        self.started.set()
        await self.ended.wait()
        await self.server.close()

    def end(self) -> None:
        self.loop.call_soon_threadsafe(self.ended.set)
        self.thread.join(30)

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.server.port}"

    def ask(self, path: str = "", body: bytes | None = None, *, token: str | None = None, **headers: str):
        """Status, headers and bytes of an answer; an Origin as a browser would send it, unless another is given."""
        token = self.server.token if token is None else token
        sent = {} if body is None else {"Origin": self.origin, "Content-Type": "application/json"}
        with closing(http.client.HTTPConnection("127.0.0.1", self.server.port, timeout=30)) as connection:
            connection.request("GET" if body is None else "POST", f"/{token}/{path}", body, {**sent, **headers})
            answer = connection.getresponse()
            return answer.status, answer.headers, answer.read()


@pytest.fixture(scope="module")
def served(rig: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    study = Study(model=str(rig / "carriage.py"), noise={"v": 2e-3}, at_rest=True)
    model, uploads = build_model(study), tmp_path_factory.mktemp("uploads")
    bench = Workbench(
        Session(model, noise={"v": 2e-3}), StudyOnFile(study, model), uploads.parent / "out", uploads=uploads
    )
    one = Served(bench)
    yield one
    one.end()


def test_the_page_comes_with_a_policy_that_runs_its_own_scripts_only(served: Served) -> None:
    status, headers, body = served.ask()
    assert status == 200 and body.decode() == page_text()
    policy = headers["Content-Security-Policy"]
    assert policy == page_policy()
    assert policy.startswith("default-src 'none'; script-src 'sha256-") and "unsafe-eval" not in policy
    assert "script-src 'unsafe-inline'" not in policy and "frame-ancestors 'none'" in policy
    assert headers["Referrer-Policy"] == "no-referrer" and headers["Cache-Control"] == "no-store"
    assert "http://" not in body.decode().replace("http://www.w3.org", "").partition('id="plotly"')[0]


@pytest.mark.parametrize("path", ["", "state", "events", "do/fit", "records"])
@pytest.mark.parametrize("token", ["", "x", "guess-of-the-right-length-AAAAAA"])
def test_without_the_token_nothing_comes_back(served: Served, path: str, token: str) -> None:
    for body in (None, b"{}"):
        status, _, content = served.ask(path, body, token=token)
        assert status in (403, 405) and content == b""


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "evil.example:80"},
        {"Host": "127.0.0.1"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
    ],
)
def test_a_page_of_another_server_gets_nothing_even_with_the_token(served: Served, headers: dict[str, str]) -> None:
    status, _, content = served.ask("do/undo", b"{}", **headers)
    assert status == 403 and content == b""
    status, _, content = served.ask("state", **headers)
    assert status == 403 and content == b""


def test_a_request_that_changes_something_must_say_where_it_is_from(served: Served) -> None:
    with closing(http.client.HTTPConnection("127.0.0.1", served.server.port, timeout=30)) as connection:
        connection.request("POST", f"/{served.server.token}/do/undo", b"{}")
        assert connection.getresponse().status == 403


def test_it_listens_on_this_machine_alone(served: Served) -> None:
    for sock in served.server._http._sockets.values():
        assert sock.getsockname()[0] == "127.0.0.1"


def test_a_record_is_uploaded_shown_and_forgotten(served: Served, rig: Path) -> None:
    data = (rig / "train.csv").read_bytes()
    status, _, content = served.ask("records?name=..%2F..%2Fetc%2Ftrain.csv&validates=0", data)
    state = json.loads(content)
    assert status == 200 and [r["name"] for r in state["records"]] == ["train"]
    stored = served.bench.session.records[0].file
    assert stored.parent == served.bench.uploads and stored.stat().st_mode & 0o077 == 0
    status, _, content = served.ask("do/preview", b'{"record": 0, "values": {"B": 2.5}}')
    assert status == 200 and json.loads(content)["figures"]["run"]["views"][0]["name"] == "v"
    status, _, content = served.ask("do/forget", b'{"record": 0}')
    assert status == 200 and json.loads(content)["records"] == []


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("records?name=a.exe", b"x"),
        ("records?name=a.csv", b"no,record\n1,2\n"),
        ("records?name=.csv", b""),
        ("do/values", b'{"values": {"B": "2"}}'),
        ("do/values", b'{"values": {"B": NaN}}'),
        ("do/values", b"{}"),
        ("do/preview", b'{"record": 5, "values": {"B": 2}}'),
        ("do/effect", b'{"name": "frictoin", "on": true}'),
        ("do/fit", b"{}"),
        ("do/export", b"{}"),
    ],
)
def test_bad_input_is_one_message_and_changes_nothing(served: Served, path: str, body: bytes) -> None:
    before = served.bench.session
    status, _, content = served.ask(path, body)
    answer = json.loads(content)
    assert status == 422 and answer["error"]
    # Where headers do not match, the page asks which column is which signal.
    assert set(answer) == ({"error", "choice"} if b"no,record" in body else {"error"})
    assert served.bench.session is before


def test_what_nobody_expected_is_told_too(served: Served, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setattr(served.bench, "undo", lambda: 1 / 0)
    status, _, content = served.ask("do/undo", b"{}")
    assert status == 500 and json.loads(content) == {"error": "ZeroDivisionError: division by zero"}
    assert "Traceback" in capsys.readouterr().err


def test_a_request_too_large_or_not_understood_is_refused(served: Served) -> None:
    assert served.ask("do/values", b"[]")[0] == 403
    assert served.ask("do/nothing", b"{}")[0] == 403
    with socket.create_connection(("127.0.0.1", served.server.port), timeout=30) as raw:
        head = f"POST /{served.server.token}/do/values HTTP/1.1\r\nHost: 127.0.0.1:{served.server.port}\r\n"
        raw.sendall(f"{head}Origin: {served.origin}\r\nContent-Length: 5000000\r\n\r\n".encode())
        assert b" 200 " not in raw.recv(1000).partition(b"\r\n")[0]


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["no_such_model"], "no_such_model"),
        (["micro_actuator", "missing.csv"], "missing.csv"),
        (["micro_actuator", "--starts", "4"], "--starts"),
        (["micro_actuator", "--profile", "K", "--bootstrap", "200"], "--bootstrap"),
        (["micro_actuator", "--fix", "Q=1"], "Q"),
    ],
)
def test_bad_input_of_the_command_ends_with_2_and_one_sentence(
    arguments: list[str], named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["app", *arguments])
    assert done.exit_code == 2 and named in done.stderr and done.stderr.startswith("error: ")
    assert not list(tmp_path.iterdir())
