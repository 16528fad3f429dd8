"""Draws the packages and their imports, as they are in the code, into ``docs/imports.svg``.

Run ``python docs/draw_imports.py`` after a part was added or began to import another one. An arrow
leads from a part to one that it imports; arrows that follow from others are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from graphlib import TopologicalSorter
from html import escape
from pathlib import Path

import grimp

PICTURE = Path(__file__).parent / "imports.svg"
BANDS: tuple[dict[str, int], ...] = (
    {"experiments": 6},
    {"graphrqi": 4, "scenarios": 2},
    {"sim": 6},
    {"behaviors": 6},
)
"""The layers from top to bottom: the packages in each, and how many boxes fit side by side."""
PACKAGES = tuple(package for band in BANDS for package in band)

BOX_W, BOX_H, GAP_X, GAP_Y, PAD, TITLE_H = 144, 26, 14, 30, 14, 24
WIDTH = 6 * (BOX_W + GAP_X) + GAP_X
STYLE = """
  text { font: 12px system-ui, sans-serif; fill: #24292f; text-anchor: middle }
  .title { font-weight: 600; text-anchor: start }
  .page { fill: #ffffff } .band { fill: #f3f5f8; stroke: #c9d1d9 }
  .part { fill: #ffffff; stroke: #57606a }
  .arrow { fill: none; stroke: #57606a; stroke-opacity: .55 } .head { fill: #57606a }
  @media (prefers-color-scheme: dark) {
    text { fill: #e6edf3 } .page { fill: #1e2129 } .band { fill: #262b36; stroke: #444c56 }
    .part { fill: #1e2129; stroke: #9da7b3 }
    .arrow { stroke: #9da7b3 } .head { fill: #9da7b3 }
  }
"""

Graph = Mapping[str, set[str]]


def parts(graph: grimp.ImportGraph, package: str) -> dict[str, set[str]]:
    """The modules and packages right under a package, each with those of them that it imports."""
    children = sorted(graph.find_children(package))
    inside = {child: {child, *graph.find_descendants(child)} for child in children}
    imported = {
        child: {n for m in inside[child] for n in graph.find_modules_directly_imported_by(m)}
        for child in children
    }
    return {
        child: {other for other in children if other != child and imported[child] & inside[other]}
        for child in children
    }


def without_detours(imports: Graph) -> dict[str, set[str]]:
    """The same graph without the arrows that follow from others."""
    reached: dict[str, set[str]] = {}
    for part in TopologicalSorter(imports).static_order():
        reached[part] = set().union(*({to} | reached[to] for to in imports[part]))
    return {
        part: {to for to in tos if not any(to in reached[other] for other in tos)}
        for part, tos in imports.items()
    }


def rows_of(imports: Graph, widest: int) -> list[list[str]]:
    """The parts in rows, each below all that import it, near the parts that it is joined to."""
    level: dict[str, int] = {}
    for part in TopologicalSorter(imports).static_order():
        level[part] = 1 + max((level[to] for to in imports[part]), default=-1)
    alone = {r for r in imports if not imports[r] and not any(r in t for t in imports.values())}
    rows: list[list[str]] = []
    for height in range(max(level.values()), -1, -1):
        row = [part for part in sorted(imports) if level[part] == height and part not in alone]
        rows += [row[i : i + widest] for i in range(0, len(row), widest)]
    row = sorted(alone)
    rows += [row[i : i + widest] for i in range(0, len(row), widest)]
    for _ in range(4):  # a few passes of putting each part below the mean of its importers
        place = {part: i / max(len(row) - 1, 1) for row in rows for i, part in enumerate(row)}
        for row in rows:
            joined = {
                part: [place[o] for o in imports if part in imports[o] or o in imports[part]]
                for part in row
            }
            row.sort(key=lambda r: (sum(joined[r]) / len(joined[r]) if joined[r] else 0.5, r))
    return rows


def draw() -> str:
    """The picture, as SVG."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    body: list[str] = []
    y = PAD
    for band in BANDS:
        imports = {package: without_detours(parts(graph, package)) for package in band}
        rows = {package: rows_of(imports[package], columns) for package, columns in band.items()}
        height = TITLE_H + max(map(len, rows.values())) * (BOX_H + GAP_Y)
        left = float(PAD)
        for package, columns in band.items():
            width = (WIDTH - PAD * (len(band) - 1)) * columns / sum(band.values())
            body += _band(package, imports[package], rows[package], (left, y, width, height))
            if band is not BANDS[-1]:
                body.append(_arrow_down(left + width / 2, y + height))
            left += width + PAD
        y += height + GAP_Y
    width, height = WIDTH + 2 * PAD, y - GAP_Y + PAD
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" '
        'aria-label="The packages and their parts; an arrow leads to what is imported">\n'
        f"<style>{STYLE}</style>\n"
        '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
        'markerHeight="7" orient="auto"><path class="head" d="M0,0 8,4 0,8z"/></marker></defs>\n'
        f'<rect class="page" width="{width}" height="{height}" rx="8"/>\n'
        + "\n".join(body)
        + "\n</svg>\n"
    )


def _band(
    package: str, imports: Graph, rows: list[list[str]], area: tuple[float, float, float, float]
) -> list[str]:
    """A package: its parts in rows inside an area (left, top, width, height), and their arrows."""
    left, top, width, height = area
    place: dict[str, tuple[float, float]] = {}
    for i, row in enumerate(rows):
        start = left + (width - len(row) * (BOX_W + GAP_X) + GAP_X) / 2
        for j, part in enumerate(row):
            place[part] = start + j * (BOX_W + GAP_X), top + TITLE_H + 6 + i * (BOX_H + GAP_Y)
    drawn = [
        f'<rect class="band" x="{left:g}" y="{top:g}" width="{width:g}" height="{height:g}" '
        'rx="6"/>',
        f'<text class="title" x="{left + 10:g}" y="{top + 18:g}">{escape(package)}</text>',
    ]
    for part in sorted(imports):
        for to in sorted(imports[part]):
            (x0, y0), (x1, y1) = place[part], place[to]
            a, b = x0 + BOX_W / 2, x1 + BOX_W / 2
            bend = GAP_Y * 0.9
            drawn.append(
                f'<path class="arrow" marker-end="url(#head)" d="M{a:g},{y0 + BOX_H:g} '
                f'C{a:g},{y0 + BOX_H + bend:g} {b:g},{y1 - bend:g} {b:g},{y1:g}"/>'
            )
    for part, (x, y) in sorted(place.items()):
        name = escape(part.rpartition(".")[2])
        drawn.append(
            f'<g><title>{escape(part)}</title><rect class="part" x="{x:g}" y="{y:g}" '
            f'width="{BOX_W}" height="{BOX_H}" rx="4"/>'
            f'<text x="{x + BOX_W / 2:g}" y="{y + 17:g}">{name}</text></g>'
        )
    return drawn


def _arrow_down(x: float, top: float) -> str:
    return (
        '<path class="arrow" stroke-width="2" marker-end="url(#head)" '
        f'd="M{x:g},{top:g} L{x:g},{top + GAP_Y:g}"/>'
    )


if __name__ == "__main__":
    PICTURE.write_text(draw())
