"""Draws caches: a frame, many frames, a movie; what `melp-warp preview` and `--preview` do."""

from __future__ import annotations

import contextlib
import importlib.util
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from melp_warp.errors import InputError, require

if TYPE_CHECKING:
    from melp_warp.frame import ParticleFrame
    from melp_warp.preview.draw import Camera
    from melp_warp.preview.surface import Surface

PREVIEW = "preview.png"
CAMERA_FRAMES = 9
"""Frames that the camera is fitted to, spread over the run."""

SIZES = (8, 8192)
VIDEO = (".mp4", ".mov", ".mkv", ".webm")


@dataclass(frozen=True)
class Shot:
    """Pictures that are asked for.

    Attributes:
        folder: of the cache.
        frames: first, last (None for the cache's) and step of the frames; None for the last one alone.
        out: file to write, or for several frames a name with # for the number; None for preview.png in the folder.
        movie: file of a movie to write instead, .gif, .mp4 and so on.
        width: pixels.
        height: pixels.
        fps: pictures a second of a movie; None for the cache's.
        orbit: angle by which the camera goes around the film from the first to the last frame, degrees.
        toward: direction from the film to the camera; None for the default.
        eye: where the camera stands, m; None to fit it to the film.
        look_at: what is in the middle of the picture, m; None for the middle of the film.
        fov: angle of view over the shorter side of the picture, degrees.
        environment: see `preview.render`.
        background: likewise.
        exposure: likewise; None for its default.
        layers: likewise.
        samples: likewise.
        particles: whether to draw the particles, though there is a surface.
        show: name of what the scene declares, to be drawn in false colours in place of the film's; None for these.
        device: Warp's name of the device.
    """

    folder: Path
    frames: tuple[int | None, int | None, int] | None = None
    out: Path | None = None
    movie: Path | None = None
    width: int = 800
    height: int = 800
    fps: float | None = None
    orbit: float = 0.0
    toward: Sequence[float] | None = None
    eye: Sequence[float] | None = None
    look_at: Sequence[float] | None = None
    fov: float = 22.0
    environment: str = "auto"
    background: str = "dark"
    exposure: float | None = None
    layers: int | None = None
    samples: int = 2
    particles: bool = False
    show: str | None = None
    device: str = "cpu"


class Cache:
    """A cache, to be drawn.

    Attributes:
        folder: its folder.
        frames: numbers of its frames.
        fps: frames per second.
        units: of what the scene declares, by name.
    """

    def __init__(self, folder: Path, particles: bool = False, show: str | None = None):
        from melp_warp.usd.apart import read_root
        from melp_warp.usd.schema import FREE_RIMS, WHOLE, list_frames

        self.folder, self.frames = Path(folder), list_frames(folder)
        require(bool(self.frames), "DIR", str(folder), "a folder that a run wrote, with frames in it")
        root = read_root(folder)
        self.fps = root["framesPerSecond"]
        self._rims, self._floors = [np.array(rim) for rim in root["rims"]], root["floors"]
        self._meshes = [int(p.rsplit("_", 1)[1]) for p in root["prims"] if re.fullmatch(r"FilmSurface/Region_\d+", p)]
        self._whole = WHOLE in root["prims"]
        self._with_e, self._with_l, self._l_per_e = "FilmE" in root["prims"], root["with_l"], root["l_per_e"]
        self._particles, self._bursts = particles, FREE_RIMS in root["prims"]
        self.units, self.show, self.range = root["carried"], show, (0.0, 0.0)
        known = ", ".join(self.units) or "nothing, as the scene declares nothing"
        require(show is None or show in self.units, "--show", show, f"one of {known}")
        self._meshes, self._whole = ([], False) if show else (self._meshes, self._whole)

    def film(self, frame: int) -> Surface | ParticleFrame:
        """What there is of a frame to draw: its meshes, or ones that are made of its particles, or these alone."""
        from melp_warp.mesh.outline import mesh_torn
        from melp_warp.mesh.surfaces import FOLDED, thin_out
        from melp_warp.preview.surface import Surface
        from melp_warp.usd import apart

        if self._whole and not self._particles:
            return Surface.of_whole(apart.read_whole(self.folder, frame), self._rims, self._floors)
        beads, drops = self._liquid(frame)
        if self._meshes and not self._particles:
            meshes = {k: apart.read_mesh(self.folder, frame, k) for k in self._meshes}
            return Surface(meshes, self._rims, self._floors, beads=beads, drops=drops)
        film = self._read(frame)
        if self._particles:
            return film
        e, many = film, None
        if self._with_l:
            e = self._read(frame, "FilmE") if self._with_e else thin_out(film, self._l_per_e)
            many = film
        try:
            meshes, problems = mesh_torn(e, many, self._rims, beads)
        except InputError as error:  # particles without order
            meshes, problems = {}, [str(error)]
        holes = [problem for problem in problems if not problem.endswith(FOLDED)]
        if holes:
            print(f"melp-warp: notice: frame {frame} is drawn from its particles: {holes[0]}", file=sys.stderr)
            return film
        return Surface(meshes, self._rims, self._floors, beads=beads, drops=drops)

    def _read(self, frame: int, prim: str = "Film") -> ParticleFrame:
        """A set of particles; with what is shown in place of their thickness, from 0 to the thickest that is drawn."""
        from melp_warp.optics import DISPLAY_MAX_THICKNESS
        from melp_warp.usd.apart import read_frame

        read = read_frame(self.folder, frame, prim)
        if self.show is None:
            return read
        low, high = self.range
        shown = (read.carried[self.show].astype(np.float64) - low) / max(high - low, 1e-300)
        return replace(read, thickness=(DISPLAY_MAX_THICKNESS * shown.clip(0.0, 1.0)).astype(np.float32))

    def find_range(self, frames: Sequence[int]) -> tuple[float, float]:
        """Set the range of what is shown: least and largest value in some of the frames."""
        from melp_warp.usd.apart import read_frame

        held = [read_frame(self.folder, frame).carried[self.show] for frame in spread(frames, CAMERA_FRAMES)]
        found = np.concatenate([values.astype(np.float64) for values in held])
        self.range = (float(found.min(initial=np.inf)), float(found.max(initial=-np.inf))) if len(found) else (0.0, 0.0)
        return self.range

    def _liquid(self, frame: int) -> tuple[ParticleFrame | None, ParticleFrame | None]:
        """Free rims and drops of a frame."""
        from melp_warp.usd.apart import read_frame
        from melp_warp.usd.schema import DROPS, FREE_RIMS

        return (
            tuple(read_frame(self.folder, frame, prim) for prim in (FREE_RIMS, DROPS)) if self._bursts else (None, None)
        )

    def camera(self, aspect: float = 1.0, toward: Sequence[float] | None = None, fov: float = 22.0) -> Camera:
        """One camera for all frames."""
        from melp_warp.preview.draw import Camera
        from melp_warp.usd.apart import read_frame

        frames = [read_frame(self.folder, frame) for frame in spread(self.frames, CAMERA_FRAMES)]
        return Camera.fit(frames, toward, fov, aspect=aspect)


def spread(frames: Sequence[int], count: int) -> list[int]:
    """At most `count` frames, spread evenly, the first and the last among them."""
    count = min(count, len(frames))
    return [frames[round(i * (len(frames) - 1) / max(1, count - 1))] for i in range(count)]


def shoot(shot: Shot) -> list[Path]:
    """Draw the pictures or the movie.

    Returns:
        The files.

    Raises:
        InputError: there is no such frame, an option is out of range or a file cannot be written.
    """
    from melp_warp.preview import draw as preview

    _check(shot)
    cache = Cache(shot.folder, shot.particles, shot.show)
    numbers = _numbers(cache, shot.frames)
    if shot.show is not None:
        low, high = cache.find_range(numbers)
        print(f"{shot.show}: dark blue is {low:.4g}, yellow {high:.4g} {cache.units[shot.show]}")
    names = _names(shot, numbers)
    cameras = _cameras(shot, cache, len(numbers))
    if shot.movie:
        with _movie(shot.movie, (shot.width, shot.height), shot.fps or cache.fps) as add:
            for number, camera in zip(numbers, cameras, strict=True):
                add(_draw(shot, cache, number, camera))
        return [shot.movie]
    for number, name, camera in zip(numbers, names, cameras, strict=True):
        preview.save_image(_draw(shot, cache, number, camera), name)
    return names


def _check(shot: Shot) -> None:
    for size in (shot.width, shot.height):
        require(SIZES[0] <= size <= SIZES[1], "--size", size, f"from {SIZES[0]} to {SIZES[1]} pixels")
    require(shot.fps is None or 0.0 < shot.fps <= 1000.0, "--fps", shot.fps, "above 0, up to 1000")
    require(abs(shot.orbit) <= 36000.0, "--orbit", shot.orbit, "up to 36000 degrees")
    require(not (shot.movie and shot.out), "--out", str(shot.out), "left out with --movie")
    if shot.movie is None:
        return
    ending = shot.movie.suffix.lower()
    require(ending in (".gif", *VIDEO), "--movie", str(shot.movie), f"a file ending in .gif, {', '.join(VIDEO)}")
    if ending in VIDEO:
        found = importlib.util.find_spec("imageio_ffmpeg") is not None
        require(found, "--movie", str(shot.movie), "a .gif, or `pip install 'melp-warp[movie]'` first")
        even = shot.width % 2 == 0 and shot.height % 2 == 0
        require(even, "--size", f"{shot.width}x{shot.height}", "of even width and height in a video")


def _numbers(cache: Cache, frames: tuple[int | None, int | None, int] | None) -> list[int]:
    """The frames that are asked for."""
    if frames is None:
        return cache.frames[-1:]
    first, last, step = frames
    first = cache.frames[0] if first is None else first
    last = cache.frames[-1] if last is None else last
    there = f"from {cache.frames[0]} to {cache.frames[-1]}"
    single = first == last
    for number in (first, last):
        require(number in cache.frames, "--frame" if single else "--frames", number, there)
    require(step >= 1 and first <= last, "--frames", f"{first}:{last}:{step}", "FIRST:LAST[:STEP] in ascending order")
    return [number for number in range(first, last + 1, step) if number in cache.frames]


def _names(shot: Shot, numbers: Sequence[int]) -> list[Path]:
    """The file of each picture: the run of # in its name stands for the number."""
    from melp_warp.preview.draw import check_format

    out = shot.out or shot.folder / PREVIEW
    check_format(out)
    marks = re.search(r"#+", out.name)
    if marks is None:
        several = "a name with #, such as film.####.png, for several frames (or --movie)"
        require(len(numbers) == 1 or bool(shot.movie), "--out", str(out), several)
        return [out] * len(numbers)
    return [out.with_name(out.name.replace(marks[0], f"{n:0{len(marks[0])}d}", 1)) for n in numbers]


def _cameras(shot: Shot, cache: Cache, count: int) -> list[Camera]:
    """The camera of each picture."""
    camera = cache.camera(shot.width / shot.height, shot.toward, shot.fov)
    if shot.look_at is not None:
        move = np.subtract(shot.look_at, camera.target) if shot.eye is None else np.zeros(3)
        camera = replace(camera, target=tuple(shot.look_at), eye=tuple((np.array(camera.eye) + move).tolist()))
    if shot.eye is not None:
        camera = replace(camera, eye=tuple(shot.eye), flat=False)
    if not shot.orbit:
        return [camera] * count
    turns = np.radians(shot.orbit) * (np.arange(count) / max(1, count - 1) if count > 1 else np.ones(1))
    return [camera.turned(float(turn)) for turn in turns]


def _draw(shot: Shot, cache: Cache, number: int, camera: Camera) -> np.ndarray:
    from melp_warp.optics import false_colors
    from melp_warp.preview.draw import render
    from melp_warp.preview.surface import Surface

    film = cache.film(number)
    plain = {} if isinstance(film, Surface) else {"layers": None, "background": "dark"}
    options = {"layers": shot.layers, "background": shot.background, "environment": shot.environment} | plain
    if shot.exposure is not None:
        options["exposure"] = shot.exposure
    if shot.show is not None:
        options |= {"environment": "white", "layers": 1, "exposure": 1.0, "colors": false_colors()}
    return render(film, shot.width, shot.height, camera, shot.device, samples=shot.samples, **options)


@contextlib.contextmanager
def _movie(path: Path, size: tuple[int, int], fps: float) -> Iterator[Callable[[np.ndarray], None]]:
    """Give a function that adds a picture; at the end the file is there as a whole.

    Raises:
        InputError: the program that writes videos fails.
    """
    from melp_warp.files import replacing

    with replacing(path) as partial:
        if path.suffix.lower() == ".gif":
            pictures: list[np.ndarray] = []
            yield pictures.append
            _save_gif(pictures, partial, fps)
            return
        import imageio_ffmpeg

        writer = imageio_ffmpeg.write_frames(str(partial), size, fps=fps, quality=8, macro_block_size=2)
        try:
            writer.send(None)
            yield lambda picture: writer.send(np.ascontiguousarray(picture))
        except OSError as error:
            raise InputError(f"cannot write {path}: {' '.join(str(error).split())[-200:]}") from None
        finally:
            writer.close()


def _save_gif(pictures: Sequence[np.ndarray], path: Path, fps: float) -> None:
    """Write a GIF that repeats; its pictures last whole hundredths of a second."""
    from PIL import Image

    images = [Image.fromarray(picture).quantize(256, Image.Quantize.MEDIANCUT) for picture in pictures]
    duration = max(20, 10 * round(100.0 / fps))
    images[0].save(path, format="GIF", save_all=True, append_images=images[1:], duration=duration, loop=0)
