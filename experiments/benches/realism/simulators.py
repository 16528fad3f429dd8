"""Who drives recorded vehicles on: constant velocity, laws with several numbers, six profiles.

All laws steer alike: a vehicle follows its likeliest path and returns to its lane where it is
between two; nobody changes lanes or stops at signals, and who is parked stays. Where a lane's limit
is known, it stands for the desired speed of those whose numbers were not told from how they drove.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from behaviors.populations import NUMBERS, POPULATION_TOLD
from behaviors.profiles import sample_profile
from experiments.benches.realism.likelihood import Motion
from experiments.benches.realism.start import Start
from graphrqi.calibrate.driving_on import driven_places, gap_errors, longest_led
from graphrqi.calibrate.laws import Law, prior
from graphrqi.calibrate.recorded import recorded_drivers
from graphrqi.stream import DEFAULT_MODEL, BehaviorStream, load_stream
from sim.frames import Tracks

FloatArray = NDArray[np.float64]

RESIDUAL_MPS2, RESIDUAL_S = 0.19, 1.3
"""Autocorrelated acceleration that is added under every law but Krauss's, whose drivers dawdle
(Zhang and Sun 2024, Transportation Research Part C, of highD)."""

SIGMA: Final = 0.5
"""Krauss's imperfection (SUMO's default)."""

LITERATURE: Final = (33.3, 1.6, 2.0, 0.73, 1.67)
"""IDM's first numbers, in the order of ``NUMBERS`` (Treiber, Hennecke, Helbing 2000, table I)."""

SUMO_DEFAULT: Final = (33.3, 1.0, 2.5, 2.6, 4.5)
"""SUMO's default car, in the same order; the first counts where no limit is known."""

CANDIDATES: Final = 256
"""Drivers of which each vehicle's are chosen by its past (drawn from the prior of calibration)."""

OBSERVATIONS: Final = 4.0
"""A vehicle's whole past counts as this many observations (as in
`graphrqi.calibrate.driving_on`)."""

PARKED_MPS2: Final = 1e-4
"""Acceleration of parked vehicles, m/s2: laws divide by it."""

ROUNDS: Final = 10
"""Rounds in which the candidates' shares among all vehicles of the instant are estimated."""


@dataclass(frozen=True, slots=True, eq=False)
class Drivers:
    """How everybody drives in R futures.

    Attributes:
        law: "idm" or "krauss".
        numbers: (R, n, 5) in the order of ``NUMBERS``.
    """

    law: Law
    numbers: FloatArray


def _limited(numbers: FloatArray, start: Start, factor: FloatArray | float = 1.0) -> FloatArray:
    """The same with the limit for a desired speed, where one is known."""
    wished = np.where(np.isnan(start.limit), numbers[..., 0], start.limit * factor)
    numbers[..., 0] = wished
    return numbers


def literature(start: Start, futures: int, rng: np.random.Generator) -> Drivers:
    """IDM with the numbers of its first paper, and the limit for a desired speed."""
    n = start.scene.ids.size
    return Drivers(Law.IDM, _limited(np.tile(np.array(LITERATURE), (futures, n, 1)), start))


def krauss(start: Start, futures: int, rng: np.random.Generator) -> Drivers:
    """SUMO's default car: Krauss's law, desired speeds 10 % around the limit."""
    n = start.scene.ids.size
    numbers = np.tile(np.array(SUMO_DEFAULT), (futures, n, 1))
    factor = np.clip(rng.normal(1.0, 0.1, (futures, n)), 0.2, 2.0)
    return Drivers(Law.KRAUSS, _limited(numbers, start, factor))


def calibrated(start: Start, futures: int, rng: np.random.Generator) -> Drivers:
    """IDM with each driver's own numbers, as its past up to the instant tells them.

    Candidates are judged by the gaps that they would have kept in that past. Their shares among all
    vehicles are estimated along, so that who shows little drives as the others do. The desired
    speed of who was not seen driving freely is not told by gaps: it stays the candidate's, or the
    present speed if that is higher.
    """
    mean, covariance = prior(Law.IDM)
    size = len(NUMBERS)
    tried = rng.multivariate_normal(mean[:size], covariance[:size, :size], CANDIDATES)
    past = start.tracks.part(np.arange(start.tracks.ids.size), slice(0, start.stop))
    row = {int(agent): i for i, agent in enumerate(start.scene.ids)}
    told = np.zeros((start.scene.ids.size, CANDIDATES))
    for driver in recorded_drivers(past, start.scene.road):
        led = longest_led(driver.drive)
        if driver.agent in row and led is not None:
            errors = gap_errors(driven_places(Law.IDM, tried, led), led)
            told[row[driver.agent]] = -OBSERVATIONS * np.log(np.maximum(errors, 0.05))
    told -= told.max(axis=1, keepdims=True)
    share = np.full(CANDIDATES, 1.0 / CANDIDATES)
    weight = np.exp(told) * share
    for _ in range(ROUNDS):
        weight = np.exp(told) * share
        weight /= weight.sum(axis=1, keepdims=True)
        share = 0.5 * weight.mean(axis=0) + 0.5 / CANDIDATES  # half of it stays the prior's
    chosen = (weight.cumsum(axis=1)[None] < rng.random((futures, len(weight), 1))).sum(axis=2)
    numbers = np.exp(tried)[np.minimum(chosen, CANDIDATES - 1)]
    numbers[..., 0] = np.maximum(numbers[..., 0], start.speed)
    return Drivers(Law.IDM, numbers)


@dataclass(slots=True)
class _Heard:
    """A classifier's stream that has seen so many columns of a recording."""

    tracks: Tracks
    stream: BehaviorStream
    columns: int = 0


_HEARD: list[_Heard] = []
"""That of the recording at hand: its instants come in order, and each goes on from the last one."""


def _heard(start: Start) -> BehaviorStream:
    """The classifier's stream after the past up to the instant."""
    if not _HEARD or _HEARD[0].tracks is not start.tracks or _HEARD[0].columns > start.stop:
        _HEARD[:] = [_Heard(start.tracks, load_stream(DEFAULT_MODEL))]
    heard = _HEARD[0]
    for column in range(heard.columns, start.stop):
        heard.stream.push(start.tracks.frame(column))
    heard.columns = start.stop
    return heard.stream


def profiles(start: Start, futures: int, rng: np.random.Generator) -> Drivers:
    """IDM with numbers drawn around the profile of a behaviour that the classifier believes in."""
    belief = _heard(start).posterior().worth(start.scene.ids)
    n = start.scene.ids.size
    chosen = (belief.cumsum(axis=1)[None] < rng.random((futures, n, 1))).sum(axis=2)
    drawn = [
        sample_profile(BEHAVIORS[min(int(code), len(BEHAVIORS) - 1)], rng)
        for code in chosen.ravel()
    ]
    numbers = np.array([[getattr(one, name) for name in POPULATION_TOLD] for one in drawn])
    numbers = numbers.reshape(futures, n, len(POPULATION_TOLD))
    factor = numbers[..., 0].copy()
    numbers[..., 0] *= np.maximum(start.speed, 1.0)  # where no limit is known
    return Drivers(Law.IDM, _limited(numbers, start, factor))


LAWS: Final[dict[str, Callable[[Start, int, np.random.Generator], Drivers]]] = {
    "idm-literature": literature,
    "idm-calibrated": calibrated,
    "krauss": krauss,
    "profiles": profiles,
}
"""Simulators that drive by a law."""

SIMULATORS: Final = ("recorded", "constant-velocity", *LAWS)
"""All of them. ``recorded`` is what happened, in every future: no simulator can be more likely."""


def simulate(name: str, start: Start, futures: int, seed: int) -> Iterator[Motion]:
    """Futures of an instant.

    Args:
        name: one of `SIMULATORS`.
        start: the instant.
        futures: how many.
        seed: of everything random.
    """
    if name == "recorded":
        yield from (start.recorded for _ in range(futures))
        return
    scene, sub = start.scene, start.substeps
    if name == "constant-velocity":
        moved = start.speed[:, None] * np.arange(1, start.ahead + 1) * start.tracks.step_s
        facing = np.stack([np.cos(scene.heading), np.sin(scene.heading)], axis=-1)
        xy = scene.xy[:, None] + moved[..., None] * facing[:, None]
        yield from (_straight(start, xy) for _ in range(futures))
        return
    from experiments.benches.realism.kernels import drive_on

    rng = np.random.default_rng((seed, SIMULATORS.index(name), start.stop))
    drivers = LAWS[name](start, futures, rng)
    n, steps, h = scene.ids.size, start.ahead * sub, start.tracks.step_s / sub
    path = np.where(scene.on_path, scene.path, -1)
    drivers.numbers[:, start.parked, NUMBERS.index("max_accel_mps2")] = PARKED_MPS2
    for numbers in drivers.numbers:
        noise = _residual(rng, n, steps, h) if drivers.law is Law.IDM else np.zeros((n, steps))
        noise[start.parked] = 0.0
        dawdle = SIGMA * rng.random((n, steps))
        x, _ = drive_on(
            drivers.law.code, numbers, noise, dawdle, scene.s, start.speed,
            scene.history.length / 2.0, path, scene.paths.lane, scene.paths.start, h,
        )  # fmt: skip
        places = x[:, sub - 1 :: sub]
        yield start.motion(places, places - scene.s[:, None])


def _straight(start: Start, xy: FloatArray) -> Motion:
    recorded, past = start.recorded, start.past
    heading = np.repeat(start.scene.heading[:, None], xy.shape[1], axis=1)
    return Motion(
        np.concatenate([recorded.xy[:, :past], xy], axis=1),
        np.concatenate([recorded.heading[:, :past], heading], axis=1),
        np.concatenate([recorded.valid[:, :past], np.ones(heading.shape, dtype=bool)], axis=1),
        recorded.length, recorded.width, recorded.step_s, past,
    )  # fmt: skip


def _residual(rng: np.random.Generator, n: int, steps: int, h: float) -> FloatArray:
    """(n, steps) autocorrelated noise, m/s2."""
    kept = np.exp(-h / RESIDUAL_S)
    pushed = RESIDUAL_MPS2 * np.sqrt(1.0 - kept**2) * rng.standard_normal((n, steps))
    out = np.empty((n, steps))
    before = RESIDUAL_MPS2 * rng.standard_normal(n)
    for t in range(steps):
        before = kept * before + pushed[:, t]
        out[:, t] = before
    return out
