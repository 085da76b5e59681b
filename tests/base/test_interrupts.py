"""Ctrl-C is noted and heard where the work can end; what is raised inside a library is lost, or changes what it gives."""

import signal
import threading
from types import SimpleNamespace

import casadi as ca
import pytest

import greybox.shell.terminal
from greybox.base.interrupts import HeldInterrupt, hold_interrupts
from greybox.base.parallel.jobs import run_jobs


class Lossy:
    """What its deletion raises is lost."""

    def __del__(self):
        signal.raise_signal(signal.SIGINT)


def press(number: object) -> ca.DM:
    """Ask for an end while CasADi looks whether this is a number; it looks several times."""
    if not number.pressed:
        number.pressed = True
        signal.raise_signal(signal.SIGINT)
    return ca.DM([2.0])


class Number:
    """Something that CasADi has to ask."""

    pressed = False


Number.__DM__ = press


def lose_an_interrupt(_, item):
    Lossy()
    return item


def add(_, item):
    return ca.plus(ca.DM([item]), Number()).full()


def search_on(_, item):
    """Two searches, the first of which has ended when the request comes."""
    signal.raise_signal(signal.SIGINT)
    search = SimpleNamespace(stop=False)
    with hold_interrupts(search):
        if search.stop:
            raise KeyboardInterrupt
    return item


@pytest.mark.parametrize("job", [lose_an_interrupt, add])
def test_jobs_end_after_the_one_in_which_an_interrupt_came(job):
    results, interrupted = run_jobs(job, None, [1.0, 2.0, 3.0], workers=1)
    assert interrupted
    assert [r and r.error for r in results] == ["", None, None]


def test_a_search_hears_of_the_interrupt_before_it():
    results, interrupted = run_jobs(search_on, None, [1, 2], workers=1)
    assert interrupted and results == [None, None]


def test_what_is_noted_inside_is_noted_around_it_and_the_second_one_ends_at_once():
    before = signal.getsignal(signal.SIGINT)
    outer, inner = SimpleNamespace(stop=False), SimpleNamespace(stop=False)
    with hold_interrupts() as held, hold_interrupts(outer), hold_interrupts(inner):
        assert not held.requested
        signal.raise_signal(signal.SIGINT)
        assert held.requested and outer.stop and inner.stop
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_one_that_is_ignored_stays_ignored():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with hold_interrupts() as held:
            signal.raise_signal(signal.SIGINT)
            assert not held.requested
    finally:
        signal.signal(signal.SIGINT, before)


def test_elsewhere_than_in_the_main_thread_nothing_is_noted():
    told = []

    def work():
        with hold_interrupts() as held:
            told.append((held.requested, isinstance(signal.getsignal(signal.SIGINT), HeldInterrupt)))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert told == [(False, False)]


def test_what_a_library_makes_of_an_interrupt_is_an_interrupt(capsys):
    """CasADi takes the exception for the answer that this is no number, and gives no sum."""

    def command():
        add(None, 1.0)

    before, handlers = signal.getsignal(signal.SIGINT), [signal.SIGTERM, signal.SIGHUP]
    others = {number: signal.getsignal(number) for number in handlers}
    try:
        with pytest.raises(greybox.shell.terminal.click.exceptions.Exit) as ended:
            greybox.shell.terminal.exit_on_error(command)()
    finally:
        for number, handler in {signal.SIGINT: before, **others}.items():
            signal.signal(number, handler)
    assert ended.value.exit_code == 130 and "interrupted" in capsys.readouterr().err
