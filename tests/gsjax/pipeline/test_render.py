"""What the pictures of views are called."""

import pytest

from gsjax.pipeline.render import picture_stems


@pytest.mark.parametrize(
    ("names", "stems"),
    [
        (["a.png", "b/c.jpg"], ["a", "b_c"]),
        (["a.HEIC", "a.JPG", "b.png"], ["a.HEIC", "a.JPG", "b"]),
        (["l/0.png", "l_0.png"], ["l_0.png_0", "l_0.png_1"]),
        (["", "..", "../a.png"], ["", "..", ".._a"]),
    ],
)
def test_no_two_views_share_a_name(names, stems):
    assert picture_stems(names) == stems
    assert len(set(stems)) == len(names) and not any("/" in stem for stem in stems)
