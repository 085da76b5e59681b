"""Numbers in sentences, as people read them."""

from greybox.base.document import Document
from greybox.extensions.changes.document import share_of
from greybox.show.printers.html import say_answer
from greybox.show.sentences.wording import choose_prefix, quantity_text, ratio_digits, spread_text, times_text


def test_a_percentage_above_a_hundred_is_a_whole_number():
    assert spread_text(4.87, "m", relative=True) == "487 %"
    assert share_of(-2.5, 1.0, "m") == "250 %"
    assert spread_text(0.997, "m", relative=True) == "99.7 %"
    assert spread_text(0.1234, "m", relative=True) == "12 %"


def test_a_value_that_is_written_as_one_has_the_unit_of_one():
    assert quantity_text(0.9997, "V") == "1 V" and quantity_text(-0.9997, "V") == "-1 V"
    assert quantity_text(0.998, "V") == "998 mV" and quantity_text(999.7, "m") == "1 km"
    assert choose_prefix("V", 0.9997) == (1.0, "")
    assert [ratio_digits(ratio) for ratio in (1.0, 0.95, 35.26, 1320.4)] == ["1.00", "0.950", "35.3", "1320"]


def test_a_ratio_that_is_written_as_one_is_no_number():
    assert times_text(1.0) == times_text(1.004) == times_text(0.9996) == "as much"
    assert times_text(0.994, "as large") == "0.994 times as large"
    assert times_text(118.4, "the error") == "118 times the error"


def test_an_answer_keeps_the_name_of_what_its_page_is_about():
    assert say_answer(Document("rig: 40 records", "rig: all 40 records were fitted")).startswith("rig: all")
    assert say_answer(Document("Fit of rig", "rig explains its records")).startswith("rig explains")
    assert say_answer(Document("Fit of rig", "nothing is known")).startswith("Nothing")
