"""The file that plays offline."""

import base64
import gzip
import json
import re
from pathlib import Path

import pytest

from covey.errors import OutputError
from covey.playground.messages import encode
from covey.playground.offline import feed_bytes, offline_page
from covey.playground.sample import sample_feed


def test_the_feed_is_packed_line_by_line_and_reproducibly() -> None:
    feed = list(sample_feed(agents=3, landmarks=20, seconds=2.0))
    packed = feed_bytes(feed)
    assert gzip.decompress(packed).decode().splitlines() == [encode(item) for item in feed]
    assert packed == feed_bytes(feed)


def test_the_file_holds_all_that_it_needs() -> None:
    packed = feed_bytes(sample_feed(agents=3, landmarks=20, seconds=2.0))
    page = offline_page(packed)
    found = re.search(r'<script type="application/json" id="covey-record">([^<]*)</script>', page)
    assert found is not None
    assert base64.b64decode(found[1]) == packed
    assert not re.search(r"<(script|link|img|iframe)[^>]*\s(src|href)=\"(?!data:)", page)
    assert "default-src 'none'" in page
    assert page.index("Content-Security-Policy") < page.index("<style>") < page.index("covey-record")
    assert page.rindex("<script>") > page.index("covey-scene3d")
    assert page.count("<script") == page.count("</script>") == 3


def test_a_script_cannot_end_its_element(tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text(
        '<meta charset="utf-8"><link rel="stylesheet" href="style.css">\n<script src="app.js" defer></script></body>'
    )
    (tmp_path / "style.css").write_text("")
    (tmp_path / "scene3d.js").write_text("</script>")
    (tmp_path / "app.js").write_text('const s = "</script><!--";')
    page = offline_page(b"", static=tmp_path)
    assert page.count("</script>") == 3
    assert "<!--" not in page


def test_a_page_that_is_not_built_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="make web"):
        offline_page(b"", static=tmp_path)
    for name in ("style.css", "app.js", "scene3d.js"):
        (tmp_path / name).write_text("")
    (tmp_path / "index.html").write_text("<body></body>")
    with pytest.raises(OutputError, match="has no <link"):
        offline_page(b"", static=tmp_path)


def test_numbers_survive_as_text() -> None:
    first = gzip.decompress(feed_bytes(sample_feed(agents=2, landmarks=4, seconds=0.1))).splitlines()[0]
    assert json.loads(first)["type"] == "Scene"
