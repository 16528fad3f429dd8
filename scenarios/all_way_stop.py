"""A four-way intersection where everybody stops."""

from __future__ import annotations

import functools
from typing import Final

from scenarios.four_way_intersection import four_way_intersection

all_way_stop: Final = functools.partial(four_way_intersection, control="allway_stop")

if __name__ == "__main__":
    from scenarios.command import main

    raise SystemExit(main("all_way_stop"))
