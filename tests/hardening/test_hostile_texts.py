"""Hostile texts in every field of every page, in a browser, and in every language that is written."""

from __future__ import annotations

import itertools

import pytest

from tests.extensions.export import test_hostile_texts as languages
from tests.extensions.export.test_hostile_texts import plain, read_plain  # noqa: F401
from tests.show.documents.test_hostile_pages import KINDS, pages, poison, write_page  # noqa: F401
from tests.support.browser import opened
from tests.support.hostile import CODE, ELEMENTS, MARKUP, RARER_MARKUP
from tests.support.reliability import note_row, size_of

TEXTS = (*MARKUP, *RARER_MARKUP, *CODE)
pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]


def test_each_text_in_every_field_of_every_page(tab, pages, tmp_path):  # noqa: F811
    """Each page holds all texts; from round to round they move on by a field, so that after as many rounds each has been in every field."""
    fields = opened_pages = 0
    faults = []
    rounds = min(size_of(len(TEXTS)), len(TEXTS))
    for first, kind in itertools.product(range(rounds), KINDS):
        count = itertools.count()
        texts = itertools.islice(itertools.cycle(TEXTS), first, None)
        page = poison(pages[kind], (f"{text}{next(count)}" for text in texts))
        file = write_page(page, tmp_path / "page.html")
        with opened(tab, file) as shown:
            if shown.evaluate("window.hurt") is not None or shown.locator(ELEMENTS).count():
                faults.append((kind, first))
        fields, opened_pages = fields + next(count), opened_pages + 1
        note_row(
            "hostile texts in every field of every kind of page, opened in Chromium",
            opened_pages,
            len(faults),
            f"{fields} fields with {len(TEXTS)} texts; none executed, none became markup, no error in the console",
        )
    assert not faults


def test_each_text_in_every_language(plain, read_plain, tmp_path):  # noqa: F811
    tried = 0
    for number, text in enumerate(TEXTS):
        for check in (
            languages.test_c_defines_what_it_defines_without_the_text,
            languages.test_modelica_has_the_same_lines,
            languages.test_the_c_of_an_observer_defines_what_it_defines_without_the_text,
            languages.test_the_class_of_an_observer_imports_and_runs_nothing_of_the_text,
            languages.test_the_description_of_an_fmu_is_xml_with_the_same_elements,
            languages.test_the_description_of_an_observer_is_xml_with_the_same_elements,
        ):
            check(plain, read_plain, make_folder(tmp_path, number, check), text)
            tried += 1
        for check in (
            languages.test_modelica_is_read_by_another_program,
            languages.test_python_files_import_and_run_nothing_of_the_text,
        ):
            check(plain, make_folder(tmp_path, number, check), text)
            tried += 1
    note_row(
        "hostile texts in every text of a fit, in C (compiled as C99 and C11), Modelica, Python and XML of plants and observers",
        tried,
        0,
        f"{len(TEXTS)} texts; the files compile or parse and define what they define without them",
    )


def make_folder(parent, number, check):
    """A folder of its own for a text and what is tried with it."""
    folder = parent / f"{number}-{check.__name__}"
    folder.mkdir()
    return folder
