"""The array jobs that docs/cluster.md shows, run dry: with few small episodes, and no scheduler."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from sim.store.dataset import open_dataset

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "cluster.md").read_text()
SMALL = {"--episodes 1000000": "--episodes 2 --duration-s 1", "/200": "/2"}


def block(language: str) -> str:
    (text,) = re.findall(rf"```{language}\n(.*?)```", PAGE, flags=re.DOTALL)
    return text


def run(script: str, **variables: str) -> None:
    for shown, here in SMALL.items():
        script = script.replace(shown, here)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, **variables, "PATH": path, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        ["bash", "-euc", script], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("recipe", ["slurm", "kubernetes"])
def test_the_recipe_makes_a_whole_dataset(recipe: str, tmp_path: Path) -> None:
    out = tmp_path / "data"
    for number in (2, 1):
        if recipe == "slurm":
            run(block("sh"), SLURM_ARRAY_TASK_ID=str(number), SLURM_ARRAY_TASK_COUNT="2",
                DATASET=str(out))  # fmt: skip
        else:
            job = yaml.safe_load(block("yaml"))
            assert job["spec"]["completions"] == 200
            (container,) = job["spec"]["template"]["spec"]["containers"]
            assert container["command"] == ["bash", "-euc"]
            run(container["args"][0], JOB_COMPLETION_INDEX=str(number - 1), DATASET=str(out))
    run(f"graphrqi merge {out}")
    assert len(open_dataset(out)) == 2


def test_the_array_script_is_one_that_slurm_takes(tmp_path: Path) -> None:
    """Options stand before the first command, each one that sbatch knows."""
    head, _, body = block("sh").partition("set -euo pipefail")
    options = re.findall(r"^#SBATCH --([a-z-]+)", head, flags=re.MULTILINE)
    assert {"array", "ntasks", "cpus-per-task", "mem", "time", "requeue"} <= set(options)
    assert "#SBATCH" not in body
