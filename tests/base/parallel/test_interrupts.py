"""An interrupt whose exception is lost inside a callback still ends the work."""

import signal
import threading

import pytest

from greybox.base.parallel.jobs import run_jobs
from greybox.base.parallel.local_pool import note_interrupts


class Lossy:
    """What its deletion raises is lost."""

    def __del__(self):
        signal.raise_signal(signal.SIGINT)


def lose_an_interrupt(_, item):
    Lossy()
    return item


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_jobs_end_after_the_one_in_which_an_interrupt_was_lost():
    results, interrupted = run_jobs(lose_an_interrupt, None, [1, 2, 3], workers=1)
    assert interrupted
    assert [r and r.value for r in results] == [1, None, None]


def test_the_handler_is_as_before_and_hears_of_it():
    heard = []
    before = signal.signal(signal.SIGINT, lambda *_: heard.append(1))
    try:
        with note_interrupts() as is_interrupted:
            assert not is_interrupted()
            signal.raise_signal(signal.SIGINT)
            assert is_interrupted() and heard == [1]
        signal.raise_signal(signal.SIGINT)
        assert heard == [1, 1]
    finally:
        signal.signal(signal.SIGINT, before)


def test_elsewhere_than_in_the_main_thread_nothing_is_noted():
    told = []

    def work():
        with note_interrupts() as is_interrupted:
            told.append(is_interrupted())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert told == [False]
