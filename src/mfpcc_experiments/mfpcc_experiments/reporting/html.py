"""Pages of one file that needs nothing but itself: templates, and figures inside the page."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import jinja2

_TEMPLATES = Path(__file__).parent / "templates"


def page(template: str, **content: Any) -> str:
    """
    Make a page; all text in one of HTML is escaped.

    Parameters
    ----------
    template : str
        File of the folder ``templates``.
    **content
        What the template names; `style` comes with it.

    Returns
    -------
    str
        The complete page.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=template.endswith(".html"),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template(template).render(style=source("report.css"), **content)


def source(name: str) -> str:
    """Text of a file of the folder ``templates`` that goes into a page as it is."""
    return (_TEMPLATES / name).read_text(encoding="utf-8")


def embedded(figure: Path) -> str:
    """A PNG file as base64, for an image inside the page."""
    return base64.b64encode(figure.read_bytes()).decode("ascii")
