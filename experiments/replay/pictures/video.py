"""A scene as a film, drawn without a browser: GIF by itself, MP4 with imageio-ffmpeg."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image

from behaviors.errors import InputError
from experiments.console.progress import Progress
from experiments.replay.pictures.painter import Painter
from experiments.replay.scene import ReplayScene
from sim.files import whole_file

FRAMES_PER_S: Final = {".mp4": 20.0, ".gif": 10.0}
"""By the file's ending; films play in real time."""

SIZE: Final = {".mp4": (1280, 720), ".gif": (960, 540)}
"""Width and height by the file's ending, pixels."""

MAX_FRAMES: Final = 20_000
"""Most frames of a film (a quarter of an hour)."""


def check_video(path: Path) -> None:
    """Refuse a name of a film that cannot be made, before anything is computed.

    Raises:
        InputError: if it does not end in .mp4 or .gif, or MP4 cannot be made here.
    """
    if path.suffix.lower() not in FRAMES_PER_S:
        raise InputError(f"--video: found {path.name!r}, expected a name that ends in .mp4 or .gif")
    if path.suffix.lower() == ".mp4":
        try:
            import imageio_ffmpeg  # noqa: F401
        except ImportError:
            raise InputError(
                f"{path}: found no imageio-ffmpeg, expected it for MP4: "
                "pip install 'graphrqi[video]', or name a .gif"
            ) from None


def write_video(
    scene: ReplayScene,
    path: Path,
    mode: str,
    begin_s: float | None = None,
    end_s: float | None = None,
    quiet: bool = False,
) -> int:
    """Film a scene.

    Args:
        scene: what to film.
        path: ends in .mp4 or .gif; the file appears whole or not at all.
        mode: what agents are coloured by.
        begin_s: from when, s; None for the beginning.
        end_s: until when, s; None for the end.
        quiet: whether to show no progress.

    Returns:
        How many frames it has.

    Raises:
        InputError: if the name is wrong, MP4 cannot be made here, or the times are outside.
        OSError: if it cannot be written.
    """
    check_video(path)
    ending = path.suffix.lower()
    times = scene.tracks.time_s
    begin = float(times[0]) if begin_s is None else max(begin_s, float(times[0]))
    end = float(times[-1]) if end_s is None else min(end_s, float(times[-1]))
    count = int((end - begin) * FRAMES_PER_S[ending] + 1e-6) + 1
    if end <= begin or count > MAX_FRAMES:
        raise InputError(
            f"{path}: found {begin:g} to {end:g} s, expected some time between {times[0]:g} and "
            f"{times[-1]:g} s, and at most {MAX_FRAMES / FRAMES_PER_S[ending]:g} s of it"
        )
    width, height = SIZE[ending]
    painter = Painter(scene, mode, width, height)
    with whole_file(path) as partial, Progress("drawing frames", count, quiet) as progress:

        def frames() -> Iterator[Image.Image]:
            for number in range(count):
                yield painter.draw(begin + number / FRAMES_PER_S[ending])
                progress.advance()

        if ending == ".gif":
            _write_gif(frames(), partial)
        else:
            _write_mp4(frames(), partial, (width, height))
    return count


def _write_gif(frames: Iterator[Image.Image], path: Path) -> None:
    first = next(frames).quantize(128)
    rest = (frame.quantize(palette=first, dither=Image.Dither.NONE) for frame in frames)
    duration_ms = round(1000 / FRAMES_PER_S[".gif"])
    first.save(
        path, "GIF", save_all=True, append_images=rest, duration=duration_ms, loop=0, optimize=True
    )


def _write_mp4(frames: Iterator[Image.Image], path: Path, size: tuple[int, int]) -> None:
    import imageio_ffmpeg

    writer = imageio_ffmpeg.write_frames(
        str(path), size, fps=FRAMES_PER_S[".mp4"], codec="libx264", quality=7,
        output_params=["-f", "mp4", "-movflags", "+faststart"],
    )  # fmt: skip
    writer.send(None)
    for frame in frames:
        writer.send(np.asarray(frame).tobytes())
    writer.close()
