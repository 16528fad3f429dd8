"""What a run leaves behind for its report: ``metrics.json`` and ``run.json``."""

from __future__ import annotations

import json
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import BaseModel, ConfigDict, Field, NonNegativeInt, ValidationError

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.rows import MAX_BYTES
from sim.files import write_whole
from sim.invalid_fields import first_wrong_field

SCHEMA_VERSION: Final = 1
"""Of run files; a newer one is refused."""

_PACKAGES: Final = ("graphrqi", "libsumo", "numpy", "scipy", "torch")


_AS_MANY = Field(min_length=len(BEHAVIORS), max_length=len(BEHAVIORS))
Matrix = Annotated[list[Annotated[list[NonNegativeInt], _AS_MANY]], _AS_MANY]
"""Counts of answers (columns) by true behaviour (rows)."""


Finite = Annotated[float, Field(ge=-1e300, le=1e300, allow_inf_nan=False)]
Horizon = Annotated[str, Field(pattern=r"^[0-9]{1,4}(\.[0-9]{1,6})?s$")]
"""A horizon in words: ``5s``."""


class Score(BaseModel):
    """A number with its 95 % interval (null with a single episode)."""

    model_config = ConfigDict(extra="forbid", strict=True)

    value: Finite
    low: Finite | None
    high: Finite | None
    n: int
    split: str


class Metrics(BaseModel):
    """``metrics.json``: the tables of a run.

    ``classification.<scenario>.<method>.<metric>`` and
    ``prediction.<scenario>.<predictor>.{ade_m,fde_m}.{1s,3s,5s}``.
    """

    model_config = ConfigDict(extra="forbid", strict=True)

    classification: dict[str, dict[str, dict[str, Score]]]
    prediction: dict[str, dict[str, dict[str, dict[Horizon, Score]]]]


class RunFile(BaseModel):
    """``run.json``: how a run was made and where its parts are (relative to its folder)."""

    model_config = ConfigDict(extra="forbid", strict=True)

    schema_version: int = SCHEMA_VERSION
    name: str
    seed: int
    configuration: dict[str, Any]
    packages: dict[str, str]
    dataset: str
    model: str
    protocol: str
    findings: list[str]
    confusion: dict[str, dict[str, Matrix]]


def installed() -> dict[str, str]:
    """Versions of the packages that results depend on."""
    return {name: metadata.version(name) for name in _PACKAGES}


def write_run(folder: Path, run: RunFile, metrics: Metrics) -> None:
    """Write both files, each whole or not at all."""
    for name, content in (("run.json", run), ("metrics.json", metrics)):
        text = json.dumps(content.model_dump(), indent=1, allow_nan=False) + "\n"
        write_whole(folder / name, text.encode())


def read_run(folder: Path) -> tuple[RunFile, Metrics]:
    """Read both files of a run.

    Raises:
        InputError: naming the file that is missing, broken or of a newer version.
    """
    found: list[Any] = []
    for name, kind in (("run.json", RunFile), ("metrics.json", Metrics)):
        path = folder / name
        if not path.is_file():
            raise InputError(f"{path}: found no file, expected a run made by make demo")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise InputError(f"{path}: found {size} bytes, expected at most {MAX_BYTES}")
        try:
            found.append(kind.model_validate_json(path.read_bytes()))
        except ValidationError as error:
            wrong = first_wrong_field(error, kind.model_fields)
            raise InputError(f"{path}: {wrong}") from None
    run: RunFile = found[0]
    if run.schema_version > SCHEMA_VERSION:
        raise InputError(
            f"{folder / 'run.json'}: schema_version: found {run.schema_version}, expected at most "
            f"{SCHEMA_VERSION}"
        )
    return run, found[1]
