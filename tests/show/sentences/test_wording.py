"""Numbers in sentences, as people read them."""

from greybox.extensions.changes.document import share_of
from greybox.show.sentences.wording import spread_text


def test_a_percentage_above_a_hundred_is_a_whole_number():
    assert spread_text(4.87, "m", relative=True) == "487 %"
    assert share_of(-2.5, 1.0, "m") == "250 %"
    assert spread_text(0.997, "m", relative=True) == "99.7 %"
    assert spread_text(0.1234, "m", relative=True) == "12 %"
