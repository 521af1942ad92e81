"""A report of a command: one HTML file that holds its figures and stands alone."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from pathlib import Path

from soopnav_cpp import __version__
from soopnav_cpp.scenarios.report import _STYLE
from soopnav_cpp.scenarios.report import _table as table

__all__ = ["page", "table"]


def page(
    title: str,
    *,
    under: str,
    lead: str,
    notes: Sequence[str] = (),
    tables: Sequence[tuple[str, str]] = (),
    pictures: Sequence[tuple[str, Path]] = (),
    foot: str = "",
) -> str:
    """The page.

    Parameters
    ----------
    title, under, lead : str
        Headline, the line below it, and the outcome in a sentence.
    notes : sequence of str
    tables : sequence of (headline, HTML)
        HTML as `table` makes it.
    pictures : sequence of (caption, PNG file)
    foot : str
    """
    e = html.escape
    figures = "".join(
        f'<figure><img alt="{e(caption)}" src="data:image/png;base64,'
        f'{base64.b64encode(path.read_bytes()).decode("ascii")}"><figcaption>{e(caption)}</figcaption></figure>'
        for caption, path in pictures
    )
    said = "".join(f"<li>{e(note)}</li>" for note in notes)
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{e(title)}</title><style>{_STYLE}</style></head><body>"
        f'<h1>{e(title)}</h1><p class="under">{e(under)}</p><p class="lead">{e(lead)}</p>'
        + (f"<h2>Notes</h2><ul>{said}</ul>" if said else "")
        + "".join(f"<h2>{e(headline)}</h2>{content}" for headline, content in tables)
        + (f"<h2>Figures</h2>{figures}" if figures else "")
        + f"<footer>{e(foot)} Made by soopnav {e(__version__)}.</footer></body></html>\n"
    )
