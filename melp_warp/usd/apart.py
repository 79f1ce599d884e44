"""Caches from elsewhere are opened in a process of their own.

USD is native code. On a file that it did not write it may hang or break down, and no program can hold that back within
itself. So what draws, measures or checks a folder asks a second process, which is stopped when it says nothing for
`PATIENCE` seconds and may die without harm. It is started when first asked, and asked again as often as wanted. Its
memory is limited where the system can do that.
"""

from __future__ import annotations

import atexit
import contextlib
import dataclasses
import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from melp_warp.errors import InputError
from melp_warp.frame import MeshFrame, ParticleFrame, WholeFrame
from melp_warp.usd.packing import refine_normals

PATIENCE = 60.0
"""Seconds without a word after which the other process is stopped; a second more for each megabyte of the file."""

START = 300.0
"""Seconds in which it must have started, on a machine however busy."""

MEMORY = 8 << 30
"""Bytes of memory that it may take, besides ten times the size of the file it reads."""

_KINDS = {"Particles": ParticleFrame, "Mesh": MeshFrame, "Whole": WholeFrame}
_ARRAYS = {
    kind: [field.name for field in dataclasses.fields(of) if field.name not in ("origin", "carried")]
    for kind, of in _KINDS.items()
}


class _Broken(Exception):
    """The other process was stopped or died; in words."""


class _Reader:
    """The other process."""

    def __init__(self):
        code = f"import sys; sys.path[:] = {sys.path!r}; from melp_warp.usd.apart import serve; serve()"
        self.process = subprocess.Popen(
            [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        self._answers: queue.Queue = queue.Queue()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()
        self._next(START)

    def ask(self, question: dict, size: float) -> Iterator[tuple[dict, list[bytes]]]:
        """Send a question about files of that many bytes; yield what comes back, the last one marked "done"."""
        try:
            self.process.stdin.write(json.dumps({**question, "cwd": os.getcwd()}).encode() + b"\n")
            self.process.stdin.flush()
        except OSError:
            raise _Broken("breaks down on it") from None
        while True:
            answer, data = self._next(PATIENCE + size / 1e6)
            size = answer.get("size", size)
            yield answer, data
            if "done" in answer:
                return

    def _next(self, patience: float) -> tuple[dict, list[bytes]]:
        try:
            answer = self._answers.get(timeout=patience)
        except queue.Empty:
            self.stop()
            raise _Broken(f"is not done with it after {patience:.0f} s") from None
        if answer is None:
            self.stop()
            raise _Broken("breaks down on it")
        return answer

    def _listen(self) -> None:
        pipe = self.process.stdout
        with contextlib.suppress(OSError, ValueError):
            while line := pipe.readline():
                answer = json.loads(line)
                self._answers.put((answer, [pipe.read(length) for length in answer.get("lengths", ())]))
        self._answers.put(None)

    def stop(self) -> None:
        """End it."""
        self.process.kill()
        self.process.wait()
        self._thread.join()
        with contextlib.suppress(OSError):  # what it was not told
            self.process.stdin.close()
        self.process.stdout.close()


_reader: _Reader | None = None


def _ask(question: dict, path: Path) -> Iterator[tuple[dict, list[bytes]]]:
    """Ask the other process, started if need be.

    Raises:
        InputError: what it says is wrong with the file.
        _Broken: it hangs or died.
    """
    global _reader  # noqa: PLW0603
    if _reader is None:
        _reader = _Reader()
        atexit.register(stop)
    size = path.stat().st_size if path.is_file() else 0
    try:
        for answer, data in _reader.ask(question, size):
            if "error" in answer:
                raise InputError(answer["error"])
            yield answer, data
    except _Broken:
        _reader = None
        raise


def _ask_once(question: dict, path: Path) -> tuple[dict, list[bytes]]:
    try:
        return list(_ask(question, path))[-1]
    except _Broken as error:
        raise InputError(f"{path} cannot be read: USD {error}, it is damaged") from None


def stop() -> None:
    """End the other process, if there is one."""
    global _reader  # noqa: PLW0603
    if _reader is not None:
        _reader.stop()
        _reader = None


def read_frame(directory: str | os.PathLike, frame: int, prim: str = "Film") -> ParticleFrame:
    """`usd.read_frame` for any file; numbers are within what can be drawn and measured besides.

    Raises:
        InputError: as `usd.read_frame`, or USD hangs or breaks down on the file.
    """
    return _read(directory, frame, prim)


def read_mesh(directory: str | os.PathLike, frame: int, region: int = 0) -> MeshFrame:
    """`usd.read_mesh`, likewise.

    Raises:
        InputError: as `usd.read_mesh`, or USD hangs or breaks down on the file.
    """
    from melp_warp.usd.schema import surface_prim

    return _read(directory, frame, surface_prim(region))


def read_whole(directory: str | os.PathLike, frame: int) -> WholeFrame:
    """`usd.read_whole`, likewise.

    Raises:
        InputError: as `usd.read_whole`, or USD hangs or breaks down on the file.
    """
    from melp_warp.usd.schema import WHOLE

    return _read(directory, frame, WHOLE)


def try_frame(directory: str | os.PathLike, frame: int) -> None:
    """Read and write a frame with all that is in it, to nowhere: what USD then does again it survives.

    Raises:
        InputError: the file is damaged, or USD hangs or breaks down on it.
    """
    from melp_warp.usd.schema import frame_path

    _ask_once({"call": "try", "directory": str(directory), "frame": frame}, frame_path(directory, frame))


def _read(directory: str | os.PathLike, frame: int, prim: str) -> ParticleFrame | MeshFrame | WholeFrame:
    from melp_warp.usd.schema import frame_path

    question = {"call": "frame", "directory": str(directory), "frame": frame, "prim": prim}
    answer, data = _ask_once(question, frame_path(directory, frame))
    names = [*_ARRAYS[answer["kind"]], *answer["carried"]]
    arrays = {
        name: np.frombuffer(bytes_, dtype).reshape(shape).copy()
        for name, dtype, shape, bytes_ in zip(names, answer["types"], answer["shapes"], data, strict=True)
    }
    carried = {name: arrays.pop(name) for name in answer["carried"]}
    frame = _KINDS[answer["kind"]](**arrays, origin=tuple(answer["origin"]), carried=carried)
    return refine_normals(frame) if answer["packed"] else frame


def read_root(directory: str | os.PathLike) -> dict:
    """What drawing and measuring any cache need of its root.

    Returns:
        prims: names from /World; framesPerSecond; rims: points of each wire, m; floors: point and normal of each, m;
        with_l: whether /World/Film holds L, and l_per_e; carried: names and units of what the scene declares.

    Raises:
        InputError: as `usd.read_metadata`, or USD hangs or breaks down on the file.
    """
    from melp_warp.usd.schema import ROOT

    return _ask_once({"call": "root", "directory": str(directory)}, Path(directory) / ROOT)[0]["root"]


def check_cache(directory: str | os.PathLike) -> list[str]:
    """`check.check_cache` for any folder; a file on which USD hangs or breaks down is a problem, and the last one."""
    problems, at = [], ""
    try:
        for answer, _ in _ask({"call": "check", "directory": str(directory)}, Path(directory)):
            problems += answer.get("problems", [])
            at = answer.get("at", at)
    except _Broken as error:
        problems.append(f"{at}: USD {error}: it is damaged, and what follows was not checked")
    return problems


# --- the other process -----------------------------------------------------------------------------------------------


def serve() -> None:
    """Answer questions on stdin until it ends; what USD prints goes nowhere."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the first process's
    pipe = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)

    def say(answer: dict, data: list[bytes] = ()) -> None:
        pipe.write(json.dumps({**answer, "lengths": [len(d) for d in data]}).encode() + b"\n")
        for part in data:
            pipe.write(part)
        pipe.flush()

    from melp_warp.usd import check, reading  # noqa: F401

    say({"ready": True})
    for line in sys.stdin.buffer:
        question = json.loads(line)
        try:
            os.chdir(question["cwd"])
            _limit_memory(0)
            _ANSWERS[question["call"]](question, say)
        except InputError as error:
            say({"error": str(error), "done": True})
        except Exception as error:  # whatever a file from elsewhere makes of Python's libraries
            words = " ".join(str(error).split()) or "no message"
            say({"error": f"{question['directory']} cannot be read: {type(error).__name__}: {words}", "done": True})


def _limit_memory(size: int) -> None:
    """Limit the memory of this process, with room to read a file of that many bytes."""
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        wanted = MEMORY + 10 * size
        resource.setrlimit(resource.RLIMIT_AS, (wanted if hard < 0 else min(wanted, hard), hard))


def _answer_frame(question: dict, say) -> None:
    from melp_warp.usd.conditions import check_sizes
    from melp_warp.usd.reading import read_prim
    from melp_warp.usd.schema import frame_path

    path = frame_path(question["directory"], question["frame"])
    if path.is_file():
        _limit_memory(path.stat().st_size)
    frame, packed = read_prim(question["directory"], question["frame"], question["prim"])
    check_sizes(path, frame)
    kind = next(name for name, of in _KINDS.items() if isinstance(frame, of))
    held = [*(getattr(frame, name) for name in _ARRAYS[kind]), *frame.carried.values()]
    arrays = [np.ascontiguousarray(a) for a in held]
    types, shapes = [str(a.dtype) for a in arrays], [a.shape for a in arrays]
    answer = {"kind": kind, "types": types, "shapes": shapes, "origin": frame.origin, "packed": packed, "done": True}
    answer["carried"] = list(frame.carried)
    say(answer, [a.tobytes() for a in arrays])


def _answer_try(question: dict, say) -> None:
    import tempfile

    from melp_warp.usd.layers import open_layer
    from melp_warp.usd.schema import frame_path

    path = frame_path(question["directory"], question["frame"])
    if path.is_file():
        _limit_memory(path.stat().st_size)
    layer = open_layer(path)
    with tempfile.TemporaryDirectory() as folder:
        layer.Export(str(Path(folder) / path.name))
    say({"done": True})


def _answer_root(question: dict, say) -> None:
    from melp_warp.usd.layers import read_rims
    from melp_warp.usd.reading import floors_of, holds_l, read_metadata

    metadata = read_metadata(question["directory"])
    units = metadata.get("carried")
    units = {str(name): str(unit) for name, unit in units.items()} if isinstance(units, dict) else {}
    with_l, l_per_e = holds_l(metadata)
    root = {"prims": metadata["prims"], "framesPerSecond": metadata["framesPerSecond"], "with_l": with_l}
    rims = [rim.tolist() for rim in read_rims(question["directory"])]
    root |= {"rims": rims, "floors": floors_of(metadata), "l_per_e": l_per_e, "carried": units}
    say({"root": root, "done": True})


def _answer_check(question: dict, say) -> None:
    from melp_warp.usd.check import check_cache

    def at(name: str) -> None:
        path = Path(question["directory"]) / name
        size = path.stat().st_size if path.is_file() else 0
        _limit_memory(size)
        say({"at": name, "size": size})

    for problem in check_cache(question["directory"], at):
        say({"problems": [problem]})
    say({"done": True})


_ANSWERS = {"frame": _answer_frame, "try": _answer_try, "root": _answer_root, "check": _answer_check}
