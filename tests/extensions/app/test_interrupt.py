"""Ctrl-C ends the app wherever it arrives."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.rest

pytest.importorskip("tornado", reason="the app's server is not installed")

# Python drops what a signal's handler raises while an object is deleted; the command's handler raises, as this one does.
PROGRAM = """
import asyncio, os, signal
from types import SimpleNamespace
from greybox.extensions.app.server import serve

def interrupt(*_):
    raise KeyboardInterrupt

class Deleted:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        sum(range(1000))

async def main():
    def press(address):
        # It serves by then, and nothing else would end it.
        asyncio.get_running_loop().call_soon(lambda: Deleted() and None)

    await asyncio.wait_for(serve(SimpleNamespace(close=lambda: None), 0, press), 30)

signal.signal(signal.SIGINT, interrupt)
asyncio.run(main())
print("ended")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no signals of this kind")
def test_an_interrupt_that_arrives_while_an_object_is_deleted_ends_the_app():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and done.stdout == "ended\n", done.stderr
