"""A four-way intersection where who comes from the right goes first."""

from __future__ import annotations

import functools
from typing import Final

from scenarios.four_way_intersection import four_way_intersection

right_before_left: Final = functools.partial(four_way_intersection, control="right_before_left")

if __name__ == "__main__":
    from scenarios.command import main

    raise SystemExit(main("right_before_left"))
