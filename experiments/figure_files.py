"""Figures as files: PNG for screens, PDF and SVG for papers, where they stay sharp at any size.

The same figure gives the same bytes: no date is written, and no name that is drawn by chance.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from behaviors.errors import InputError
from sim.files import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEFT_OUT: Final[dict[str, dict[str, Any]]] = {
    ".pdf": {"CreationDate": None},
    ".png": {"Software": None},
    ".svg": {"Date": None},
}
"""By the ending of a file: what matplotlib would write about when and with what it was made."""

STYLE: Final[dict[Any, Any]] = {"pdf.fonttype": 42, "svg.hashsalt": "graphrqi"}
"""TrueType letters, which publishers ask for, and names inside an SVG that do not change."""


def check_figure_file(path: Path, option: str) -> None:
    """Refuse an option's file whose name says no format of figures, or that has no folder.

    Raises:
        InputError: if so.
    """
    if path.suffix.lower() not in LEFT_OUT:
        raise InputError(f"{option}: found {path.name!r}, expected a .pdf, .png or .svg")
    if not path.parent.is_dir():
        raise InputError(f"{path}: found no folder {path.parent}, expected one")


def figure_bytes(figure: Figure, ending: str, dpi: int = 110) -> bytes:
    """Content of a figure's file with such an ending; ``dpi`` are pixels per inch of a PNG."""
    from matplotlib import rc_context

    out = io.BytesIO()
    with rc_context(STYLE):
        figure.savefig(out, format=ending[1:], dpi=dpi, metadata=LEFT_OUT[ending])
    return out.getvalue()


def write_figure(figure: Figure, path: Path, dpi: int = 110) -> None:
    """Write a figure as the file's ending says; the file appears complete or not at all."""
    write_whole(path, figure_bytes(figure, path.suffix.lower(), dpi))
