"""A four-way intersection whose east-west road has priority."""

from __future__ import annotations

import functools
from typing import Final

from scenarios.four_way_intersection import four_way_intersection

priority_intersection: Final = functools.partial(four_way_intersection, control="priority")

if __name__ == "__main__":
    from scenarios.command import main

    raise SystemExit(main("priority_intersection"))
