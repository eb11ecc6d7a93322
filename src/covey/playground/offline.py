"""A record as the page plays it, and the file that plays offline: page and record in one."""

from __future__ import annotations

import base64
import gzip
import io
from collections.abc import Iterable
from pathlib import Path

from covey.errors import OutputError
from covey.playground.messages import encode
from covey.playground.server import STATIC
from covey.runtime.watching.feed import Scene, Update

POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' blob: data:; style-src 'unsafe-inline'; img-src data: blob:; "
    "connect-src data: blob:; base-uri 'none'; form-action 'none'"
)
"""The Content-Security-Policy of the file: it can load nothing and send nothing to anybody."""

STYLE = '<link rel="stylesheet" href="style.css">'
SCRIPT = '<script src="app.js" defer></script>'
HEAD = '<meta charset="utf-8">'
"""What is replaced in the page."""


def feed_bytes(feed: Iterable[Scene | Update]) -> bytes:
    """Return a feed as lines of JSON, gzipped; equal feeds give equal bytes.

    Parameters
    ----------
    feed : iterable of Scene or Update
        As a run told it; see `covey.runtime.watching.feed`.
    """
    packed = io.BytesIO()
    with gzip.GzipFile(fileobj=packed, mode="wb", compresslevel=6, mtime=0) as lines:
        for item in feed:
            lines.write(encode(item).encode())
            lines.write(b"\n")
    return packed.getvalue()


def offline_page(record: bytes, *, static: Path | None = None) -> str:
    """Return the page with a record in it, as one file that needs no server and no network.

    Parameters
    ----------
    record : bytes
        From `feed_bytes`.
    static : Path, optional
        Directory of the built page; by default the one that comes with covey.

    Raises
    ------
    OutputError
        If the page is not built, or not such as it should be.
    """
    static = static or STATIC
    try:
        page, style, script, scene3d = (
            (static / name).read_text("utf-8") for name in ("index.html", "style.css", "app.js", "scene3d.js")
        )
    except FileNotFoundError as error:
        raise OutputError("the Playground's page is not built: run make web") from error
    for part in (STYLE, SCRIPT, HEAD, "</body>"):
        if page.count(part) != 1:
            raise OutputError(f"the Playground's page has no {part}: run make web")
    data = base64.b64encode(record).decode("ascii")
    vehicles = base64.b64encode(scene3d.encode()).decode("ascii")
    inline = (
        f'<script type="application/json" id="covey-record">{data}</script>\n'
        f'<script type="text/plain" id="covey-scene3d">{vehicles}</script>\n'
        f"<script>{_inert(script)}</script>\n"
    )
    page = page.replace(SCRIPT, "").replace("</body>", f"{inline}</body>")
    page = page.replace(STYLE, f"<style>{style}</style>")
    return page.replace(HEAD, f'{HEAD}\n<meta http-equiv="Content-Security-Policy" content="{POLICY}">')


def _inert(script: str) -> str:
    """Return a script without anything that would end or comment out the element it stands in."""
    return script.replace("</script", r"<\/script").replace("<!--", r"<\!--")
